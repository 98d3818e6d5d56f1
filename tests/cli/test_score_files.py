"""`fbench score --truth PATH --detections PATH`: results of other systems, without any replay."""

import json

import pytest

from fbench.metrics.criticality.scores import RULES
from fbench.metrics.events.scores import ARRIVALS, SLICE

CAR = "{f} {i} Car 0 0 0.5 {l} 100 {r} 190 1.5 1.6 4.0 {x} 1.7 10.0 0.1"


@pytest.fixture
def folders(tmp_path):
    """Two sequences; the results lack a car in the last frame of the second."""
    for side, score in (("truth", ""), ("results", " 0.5")):
        (tmp_path / side).mkdir()
        for name in ("0000", "0001"):
            rows = [
                CAR.format(f=f, i=i, l=99 + 200 * i, r=180 + 200 * i, x=6 * i) + score for f in range(4) for i in (0, 1)
            ]
            (tmp_path / side / f"{name}.txt").write_text("\n".join(rows) + "\n")
    path = tmp_path / "results" / "0001.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")
    return "--truth", "truth", "--detections", "results"


def test_folders_are_scored_and_shown(fbench, folders, tmp_path):
    result = fbench("score", *folders, "--profile", "trackeval-kitti", "-o", "scores.json")
    assert result.code == 0
    lines = [line.split() for line in result.out.splitlines()]
    assert ["results", "against", "truth:", "profile", "trackeval-kitti"] in lines
    assert next(line for line in lines if line[:1] == ["clr_fn"])[1] == "1"
    assert [line[0] for line in lines if line[:1] in (["0000"], ["0001"])] == ["0000", "0001"]
    assert len(lines) < 40
    rows = json.loads((tmp_path / "scores.json").read_text())
    assert set(rows[0]) == {"metric", "class", "slice", "matching", "value", "reason", "unit", "counts"}
    assert result.err == f"{len(rows)} rows: scores.json\n"
    mota = next(r for r in rows if (r["metric"], r["class"], r["slice"]) == ("mota", "car", "all"))
    assert mota["value"] == 15 / 16


def test_json_has_all_rows(fbench, folders):
    result = fbench("score", *folders, "--json").json()
    assert result["profile"] == "default"
    assert result["scores"][0] | {"counts": 0} == {
        "metric": "f1", "class": "vehicle", "slice": "all", "matching": "bev 2 m", "value": 30 / 31, "reason": None,
        "unit": "1", "counts": 0,
    }  # fmt: skip


def test_match_class_and_sequences(fbench, folders):
    options = ("--profile", "kitti-3dmot", "--match", "iou3d:0.5", "--class", "car", "--sequences", "0000", "--json")
    rows = fbench("score", *folders, *options).json()["scores"]
    assert {(r["class"], r["matching"], r["slice"]) for r in rows} == {("car", "iou3d 0.5", "all")}


def test_notes_go_to_stderr(fbench, folders, tmp_path):
    (tmp_path / "results" / "0007.txt").write_text("")
    (tmp_path / "results" / "0000.txt").unlink()
    result = fbench("score", *folders)
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "fbench: results: no results for sequence 0000; add an empty file" in result.err
    result = fbench("score", *folders, "--missing", "empty")
    assert result.code == 0
    assert result.err.splitlines() == [
        "no truth for sequence 0007: left out [GT001]",
        "no results for sequence 0000: all of its truth is missed",
    ]


def test_truth_for_no_sequence_is_an_error(fbench, folders, tmp_path):
    (tmp_path / "truth" / "0001.txt").unlink()
    result = fbench("score", *folders, "--sequences", "0001")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "no truth for any sequence" in result.err


@pytest.mark.slow
def test_lost_boxes_are_told_by_the_exit_code(fbench, folders, tmp_path):
    path = tmp_path / "truth" / "0000.txt"
    path.write_text(path.read_text().replace(" 10.0 ", " nan ", 1))
    result = fbench("score", *folders)
    assert result.code == 4
    assert result.err == (
        "1 x truth box isn't finite or has no size [GT004]: truth, sequence 0000: 1 of class 'car'\n"
    )  # fmt: skip
    path = tmp_path / "results" / "0001.txt"
    path.write_text(path.read_text().replace(" 10.0 ", " inf ", 1))
    for profile in ("default", "kitti-3dmot", "trackeval-kitti", "kitti-object", "coco", "motmetrics"):
        result = fbench("score", *folders, "--profile", profile, "--json")
        assert result.code == 4
        assert "[PRD001]: results, sequence 0001: 1" in result.err


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        ((), 2, "what is to be scored? give a RUN folder, or --truth PATH and --detections PATH"),
        (("--detections", "results"), 2, "--truth PATH is missing"),
        (("--truth", "truth"), 2, "--detections PATH is missing"),
        (("run", "--detections", "results"), 2, "--detections are scored without a RUN"),
        (("run", "--match", "bev:2"), 2, "--match goes with --profile"),
        (("run", "--seqmap", "x"), 2, "--seqmap goes with --truth and --detections, without a RUN"),
        (("run", "--profile", "coco", "--iou", "0.3"), 2, "--iou doesn't go with --profile; use --match iou2d:SHARE"),
        (("run", "--profile", "coco", "--truth", "truth"), 2, "--profile takes the truth that the run has"),
        (("run", "--profile", "coco"), 2, "run: no such run folder"),
        (("FILES", "--range-m", "30"), 2, "--range-m is for run folders"),
        (("FILES", "--distance-m", "3"), 2, "--distance-m is for run folders; use --match bev:M"),
        (("FILES", "--profile", "kiti-3dmot"), 2, "unknown profile 'kiti-3dmot'; did you mean 'kitti-3dmot'?"),
        (("FILES", "--profile", "coco", "--match", "iou3d:0.5"), 2, "can't match by iou3d"),
        (("FILES", "--match", "iou4d:0.5"), 2, "--match iou4d:0.5: unknown 'iou4d'; did you mean"),
        (("FILES", "--match", "iou3d"), 2, "--match iou3d: expected iou3d:NUMBER"),
        (("FILES", "--match", "iou3d:7"), 2, "match iou3d:7: expected above 0 and up to 1"),
        (("FILES", "--class", "tram"), 2, "--class tram: the profile has no rows of it"),
        (("FILES", "--sequences", "0002"), 2, "--sequences 0002: no such sequence; did you mean '000"),
        (("FILES", "--sequences", ","), 2, "--sequences: names no sequence"),
        (("FILES", "--missing", "zero"), 2, "--missing zero: expected error or empty"),
        (("FILES", "--seqmap", "none"), 2, "--seqmap none: no such file"),
        (("FILES", "--truth-format", "kity"), 2, "'kity' is no form of boxes that can be scored"),
        (("FILES", "--detections-format", "mot"), 3, "0000.txt line 1: 1 columns, expected 6 to 10"),
        (("FILES", "--profile", "trackeval-mot"), 3, "car"),
        (("--truth", "none", "--detections", "results"), 2, "none: no such file or folder"),
        (("--truth", "truth", "--detections", "/dev/null"), 2, "neither a regular file nor a folder"),
    ],
)
def test_what_cant_be_done_is_one_line(arguments, code, told, fbench, folders):
    given = folders + arguments[1:] if arguments[:1] == ("FILES",) else arguments
    result = fbench("score", *given)
    assert told in result.err
    assert result.code == code
    assert result.err.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0 1 Car 0 0\n", "5 columns"),
        ("0 1 Car 0 0 0.5 left 100 180 190 1.5 1.6 4.0 1 1.7 10.0 0.1\n", "line 1: left is 'left', expected a number"),
        ("99999999999 1 Car 0 0 0.5 1 100 180 190 1.5 1.6 4.0 1 1.7 10.0 0.1\n", "line 1: frame is 99999999999"),
        ("0 1 Car 0 0 0.5 1 100 180 190 1.5 1.6 4.0 1 1.7 10.0 0.1\n" * 2, "id 1 twice in frame 0; an id names one"),
        ("\x00\xff\n", "UTF-8"),
    ],
)
def test_wrong_files_are_one_line(text, told, fbench, folders, tmp_path):
    (tmp_path / "results" / "0001.txt").write_bytes(text.encode("latin-1"))
    result = fbench("score", *folders, "--detections-format", "kitti-tracking")
    assert result.code == 3
    assert told in result.err
    assert result.err.count("\n") == 1


def test_a_run_by_a_profile(fbench, log, tmp_path):
    assert fbench("replay", log, "-p", "lidar3d", "--set", "lidar.judge=rules", "-o", "run").code == 0
    before = (tmp_path / "run/scores.json").read_bytes()
    result = fbench("score", "run", "--profile", "coco", "-o", "coco.json")
    assert result.code == 0
    assert "run: profile coco" in result.out
    result = fbench("score", "run", "--profile", "kitti-3dmot", "--match", "iou3d:0.25")
    assert result.code == 0
    assert result.err == "run: the results have no classes, so none of them is of a class of kitti-3dmot\n"
    result = fbench("score", "run", "--profile", "default", "--match", "iou3d:0.25", "--json")
    assert {row["matching"].partition(",")[0] for row in result.json()["scores"]} == {"iou3d 0.25"}
    own = fbench("score", "run", "--profile", "default", "--json").json()["scores"]
    rows = [row for row in json.loads(before) if not row["slice"].startswith(SLICE)]
    assert own == [row for row in rows if row["metric"] not in (*RULES, *ARRIVALS)]  # Those are no matter of matching
    assert (tmp_path / "run/scores.json").read_bytes() == before


def test_plugins_tell_metrics_and_profiles(fbench):
    result = fbench("plugins", "metrics", "hota")
    assert result.code == 0
    for word in ("sqrt(DetA AssA)", "0 to 1", "higher", "null when", "https://arxiv.org/abs/2009.07736"):
        assert word in result.out
    result = fbench("plugins", "metrics")
    assert "detection" in result.out
    assert "occlusion_survival" in result.out
    result = fbench("plugins", "profiles")
    assert "nuscenes-tracking" in result.out
    result = fbench("plugins", "profiles", "kitti-3dmot")
    assert ["rules.match", "iou3d", "0.25"] in [line.split() for line in result.out.splitlines()]
    result = fbench("plugins", "metrics", "tracking")
    assert result.code == 0
    assert "fbench.metrics.runs.tracking:Tracking" in result.out
    assert "CLEAR MOT, identity and HOTA of `run.tracks`." in result.out
    result = fbench("plugins", "metrics", "hotaa")
    assert (result.code, result.err) == (2, "fbench: unknown metric 'hotaa'; did you mean 'hota'?\n")
    result = fbench("plugins", "profiles", "cocoa")
    assert (result.code, result.err) == (2, "fbench: unknown profile 'cocoa'; did you mean 'coco'?\n")
    result = fbench("plugins", "profile")
    assert (result.code, result.err) == (2, "fbench: unknown group 'profile'; did you mean 'profiles'?\n")
    known = fbench("plugins", "nonsense").err.strip().partition("there are: ")[2].split(", ")
    assert len(known) == len(set(known))
