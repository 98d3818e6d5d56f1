"""What `fbench score` says of results that are odd, lack something or aren't all scored: one line each on stderr."""

import json

import pytest

CAR = "{f} {i} {label} 0 0 0.5 {l} 100 {r} 190 1.5 1.6 4.0 {x} 1.7 10.0 0.1"
FILES = ("--truth", "truth.txt", "--detections", "results.txt")


def rows(label="Car", score="", first=0):
    return [
        CAR.format(f=f, i=first + i, label=label, l=99 + 200 * i, r=180 + 200 * i, x=6 * i) + score
        for f in range(4)
        for i in (0, 1)
    ]


def write(path, lines):
    path.write_text("\n".join(lines) + "\n")


def without_ids(lines, num):
    return [" ".join([line.split()[0], "-1", *line.split()[2:]]) for line in lines[:num]] + lines[num:]


@pytest.fixture
def files(tmp_path):
    write(tmp_path / "truth.txt", rows())
    write(tmp_path / "results.txt", rows(score=" 0.5"))
    return tmp_path


@pytest.mark.parametrize("profile", ["trackeval-kitti", "kitti-3dmot", "motmetrics"])
@pytest.mark.parametrize("side", ["truth", "results"])
def test_tracks_need_ids(fbench, files, profile, side):
    lines = (files / f"{side}.txt").read_text().splitlines()
    write(files / f"{side}.txt", without_ids(lines, len(lines)))
    result = fbench("score", *FILES, "--profile", profile)
    assert (result.code, result.out, result.err.count("\n")) == (3, "", 1)
    assert "id" in result.err
    if profile != "motmetrics":
        what = "truth boxes" if side == "truth" else "results"
        assert result.err == f"fbench: {side}.txt: none of the 8 {what} has a track id; {profile} needs them\n"


def test_results_without_ids_still_have_detection_scores(fbench, files):
    write(files / "results.txt", without_ids(rows(score=" 0.5"), 8))
    result = fbench("score", *FILES)
    assert (result.code, result.err) == (0, "")
    assert "tracks have no ids" in result.out


def test_some_missing_ids_are_counted(fbench, files):
    write(files / "results.txt", without_ids(rows(score=" 0.5"), 3))
    for profile in ("trackeval-kitti", "kitti-3dmot"):
        result = fbench("score", *FILES, "--profile", profile)
        assert (result.code, result.err) == (0, "results.txt: 3 of 8 results have no id and are left out\n")
    result = fbench("score", *FILES, "--profile", "default")
    assert result.err == "results.txt: 3 of 8 results have no id and count as tracks of their own\n"


def test_classes_that_arent_scored_are_counted(fbench, files):
    write(files / "results.txt", [*rows(score=" 0.5"), *rows("Ufo", " 0.5", 5), *rows("Person_sitting", " 0.5", 7)[:1]])
    told = "9 results are of classes that {} doesn't score: ufo (8), person_sitting (1)"
    for profile in ("trackeval-kitti", "kitti-object"):
        result = fbench("score", *FILES, "--profile", profile)
        assert (result.code, result.err) == (0, f"results.txt: {told.format(profile)}\n")
    # AB3DMOT takes sitting people for neighbors of pedestrians.
    result = fbench("score", *FILES, "--profile", "kitti-3dmot")
    assert result.err == "results.txt: 8 results are of classes that kitti-3dmot doesn't score: ufo (8)\n"
    result = fbench("score", *FILES, "--profile", "coco")
    assert (
        "9 results are of classes that the truth lacks, which have no AP: ufo (8), person_sitting (1)\n" in result.err
    )
    result = fbench("score", *FILES)
    assert result.err == (
        "results.txt: 8 results are of classes that fbench doesn't know, which count as other: ufo (8)\n"
    )  # fmt: skip


def test_ties_are_said_where_tools_rank_by_the_file(fbench, files):
    tied = "results.txt: 8 results share their score with another of their class: "
    assert fbench("score", *FILES, "--profile", "coco").err.startswith(tied)
    write(files / "results.txt", [line + f" 0.{i}" for i, line in enumerate(rows())])
    assert fbench("score", *FILES, "--profile", "coco").err == ""


def test_rectangles_are_no_matter_in_space(fbench, files):
    thin = rows(score=" 0.5")
    thin[2] = thin[2].replace(" 180 190 ", " 99 190 ")
    write(files / "results.txt", thin)
    result = fbench("score", *FILES, "--profile", "kitti-3dmot")
    assert (result.code, result.err) == (0, "")
    result = fbench("score", *FILES, "--profile", "motmetrics")
    assert result.code == 4
    assert result.err == (
        "1 x result is no box, or its score isn't finite [PRD001]: results.txt, sequence truth: 1\n"
    )  # fmt: skip
    for side in ("truth", "results"):
        (files / side).mkdir()
        for name in ("0000", "0001"):
            write(files / side / f"{name}.txt", thin if side == "results" else rows())
    result = fbench("score", "--truth", "truth", "--detections", "results", "--profile", "motmetrics")
    assert "[PRD001]: results, sequence 0000: 1; 1 more place\n" in result.err
    write(files / "results.txt", [line.replace(" 1.5 1.6 4.0 ", " 1.5 0.0 4.0 ") for line in rows(score=" 0.5")])
    assert fbench("score", *FILES, "--profile", "motmetrics").code == 0
    assert fbench("score", *FILES).code == 4


def test_boxes_beyond_all_numbers_give_no_warning(fbench, tmp_path):
    (tmp_path / "gt.txt").write_text("1,1,10,20,30,40,1,1,1\n")
    (tmp_path / "r.txt").write_text("1,1,1e400,20,30,40,1,-1,-1,-1\n")
    result = fbench("score", "--truth", "gt.txt", "--detections", "r.txt", "--profile", "trackeval-mot")
    assert (result.code, result.err.count("\n")) == (4, 1)


def test_the_class_of_ten_columns_is_read_in_results(fbench, tmp_path):
    (tmp_path / "gt.txt").write_text("1,1,10,20,30,40,1,1,1\n")
    for row in ("1,1,10,20,30,40,1,2,1,-1", "1,1,10,20,30,40,1,2,1,-1,"):
        (tmp_path / "r.txt").write_text(row + "\n")
        result = fbench("score", "--truth", "gt.txt", "--detections", "r.txt", "--profile", "trackeval-mot")
        assert (result.code, result.err.count("\n")) == (3, 1)
        assert "results of class 'person on vehicle', expected" in result.err
    (tmp_path / "r.txt").write_text("1,1,10,20,30,40,1,2.5,1,-1\n")  # a place in meters
    assert fbench("score", "--truth", "gt.txt", "--detections", "r.txt", "--profile", "trackeval-mot").code == 0


def box(token, x, score, **others):
    found = {
        "sample_token": token, "translation": [x, 0, 0], "size": [2, 4, 1.5], "rotation": [1, 0, 0, 0],
        "velocity": [0, 0], "detection_name": "car", "detection_score": score, "attribute_name": "vehicle.parked",
        "ego_translation": [x, 0, 0], "num_pts": 5,
    }  # fmt: skip
    return found | others


def submission(path, results, **others):
    path.write_text(json.dumps({"results": results} | others))


def test_what_nuscenes_would_refuse_is_said(fbench, tmp_path):
    submission(tmp_path / "t.json", {str(i): [box(str(i), 5 + 6 * j, -1.0) for j in range(3)] for i in range(4)})
    scores = iter(i / 100 for i in range(9))
    results = {str(i): [box(str(i), 5 + 6 * j, next(scores)) for j in range(3)] for i in range(3)}
    results["0"][0] |= {"sample_token": "2"}
    results["1"][0]["attribute_name"] = "nope"
    results["1"][1]["velocity"] = None
    results["2"][0]["detection_name"] = "ufo"
    submission(tmp_path / "r.json", results)
    arguments = ("score", "--truth", "t.json", "--profile", "nuscenes-detection", "--detections")
    result = fbench(*arguments, "r.json")
    assert result.code == 0
    assert result.err.splitlines() == [
        "r.json: 1 x submission without 'meta', which nuscenes-devkit refuses",
        "r.json: 1 x box whose sample_token names another sample than it is under: sample '0'",
        "r.json: 1 x box with an attribute that nuScenes doesn't have: sample '1'",
        "r.json: 1 x box without a velocity, which counts as unknown: sample '1'",
        "r.json: 1 x frame that the results have no entry for, so that all of its truth is missed: sequence t, 3",
        "r.json: 1 result is of classes that nuscenes-detection doesn't score: ufo (1)",
    ]
    scores = iter(i / 100 for i in range(12))
    for name in "0123":
        results[name] = [
            {"tracking_name": "car", "tracking_score": next(scores), "tracking_id": str(j)}
            | {k: v for k, v in box(name, 5 + 6 * j, 0).items() if not k.startswith(("detection", "attribute"))}
            for j in range(3)
        ]
    submission(tmp_path / "r.json", results, meta={})
    result = fbench(*arguments, "r.json")
    told = "r.json: 1 x submission of tracking, whose boxes are taken as detections\n"
    assert (result.code, result.err) == (0, told)


def test_images_without_a_file_of_results_are_counted(fbench, tmp_path):
    for side, num, score in (("label_2", 3, ""), ("results", 1, " 0.5")):
        (tmp_path / side).mkdir()
        for i in range(num):
            line = " ".join(rows(score=score)[0].split()[2:])
            write(tmp_path / side / f"{i:06d}.txt", [line])
    result = fbench("score", "--truth", "label_2", "--detections", "results", "--profile", "kitti-object")
    assert result.code == 0
    assert result.err == (
        "results: 2 x frame that the results have no entry for, so that all of its truth is missed: "
        "sequence label_2, 1 ...\n"
    )


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("-o", "."), "-o .: is a folder; name a file in it"),
        (("-o", "/dev/null/x.json"), "/dev/null/x.json: can't be written (Not a directory: /dev/null)"),
        (("--intervals", "19"), "--intervals 19: expected 20 to 100000, such as 1000"),
        (("--intervals", "1000000000"), "--intervals 1000000000: expected 20 to 100000, such as 1000"),
        (("--profile", ""), "--profile: names no profile; see fbench plugins profiles"),
    ],
)
def test_options_are_refused_before_anything_is_read(fbench, tmp_path, arguments, told):
    result = fbench("score", "--truth", "nowhere", "--detections", "nowhere", *arguments)
    assert (result.code, result.err) == (2, f"fbench: {told}\n")
    assert list(tmp_path.iterdir()) == []


def test_shares_and_counts_of_tracks_look_different(fbench, files):
    def cell(profile):
        out = fbench("score", *FILES, "--profile", profile).out
        return next(line.split()[1] for line in out.splitlines() if line.startswith("mt "))

    assert (cell("kitti-3dmot"), cell("trackeval-kitti")) == ("1.000", "2")


def test_tables_say_why_there_is_no_interval(fbench, files):
    result = fbench("score", *FILES, "--intervals", "50")
    assert result.err == "--intervals 50: so few resamples give only rough limits; 1000 are usual\n"
    assert any(line.startswith("– no interval of f1, ") and line.endswith(": 1 sequences, at least 5 are needed")
               for line in result.out.splitlines())  # fmt: skip
