"""Files of both sides become sequences."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.feather as pf
import pytest
from tests.metrics.files.conftest import kitti_row, kitti_text

from fbench.metrics.files.sequences import Choice, open_files, open_source
from fbench.replay.contracts.errors import ConfigError, FbenchError, LogError, MetricError

COLUMNS = "frame,label,track_id,score,left,top,right,bottom"


def sequences(truth, estimates, *args, **choice):
    pair = open_files(truth, estimates, Choice(**choice), *args)
    return list(pair.sequences()), pair


def test_folders_are_paired_by_name(write, tmp_path):
    for name in ("0000", "0003"):
        write(f"truth/label_02/{name}.txt", kitti_text(3))
        write(f"results/data/{name}.txt", kitti_text(2, score=0.5))
    write("results/car_summary.txt", "HOTA DetA\n1 2\n")
    found, pair = sequences(tmp_path / "truth", tmp_path / "results")
    assert (pair.truth.form, pair.estimates.form) == ("kitti-tracking", "kitti-tracking")
    assert [(s.name, len(s.steps), len(s.truth), len(s.estimates)) for s in found] == [
        ("0000", 3, 6, 4), ("0003", 3, 6, 4)
    ]  # fmt: skip
    assert pair.notes == ()


def test_logs_of_argoverse_2_are_called_as_their_folders(tmp_path):
    names = ("x", "y", "z", "length", "width", "height")
    theirs = ("tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m")
    turn = {"qw": [1.0] * 2, "qx": [0.0] * 2, "qy": [0.0] * 2, "qz": [0.0] * 2}
    for name in ("a", "b"):
        (tmp_path / "val" / name).mkdir(parents=True)
        truth = {
            "timestamp_ns": [10**9, 2 * 10**9],
            "category": ["BUS"] * 2,
            **dict.fromkeys(theirs, [1.0] * 2),
            **turn,
        }
        pf.write_feather(pa.table(truth), tmp_path / "val" / name / "annotations.feather")
        pf.write_feather(pa.table({"timestamp_ns": [10**9]}), tmp_path / "val" / name / "city_SE3_egovehicle.feather")
    own = {"timestamp_ns": [10**9] * 2, "category": ["BUS"] * 2, "log_id": ["a", "b"], "score": [0.5, 0.7], **turn}
    pf.write_feather(pa.table({**own, **dict.fromkeys(theirs, [1.0] * 2)}), tmp_path / "results.feather")
    found, _ = sequences(tmp_path / "val", tmp_path / "results.feather")
    assert [(s.name, len(s.truth), len(s.estimates)) for s in found] == [("a", 2, 1), ("b", 2, 1)]
    assert found[1].estimates.score.tolist() == [0.7]
    for one in (tmp_path / "val" / "b", tmp_path / "val" / "b" / "annotations.feather"):
        [found], _ = sequences(one, tmp_path / "results.feather")
        assert (found.name, len(found.truth)) == ("b", 2)
    # Columns of fbench in Feather, too; two single files needn't be called alike.
    columns = {"stamp_ns": [10**9] * 2, "label": ["bus"] * 2, "yaw": [0.0] * 2, **dict.fromkeys(names, [1.0] * 2)}
    pf.write_feather(pa.table(columns), tmp_path / "mine.feather")
    [found], _ = sequences(tmp_path / "mine.feather", tmp_path / "mine.feather")
    assert len(found.truth) == len(found.estimates) == 2


def test_length_is_that_of_the_last_box_or_of_the_seqmap(write):
    truth, results = write("a/0000.txt", kitti_text(3)), write("b/0000.txt", kitti_text(5, score=1))
    assert len(sequences(truth, results)[0][0].steps) == 5
    seqmap = write("seqmap", "0000 empty 000000 000009\n")
    assert len(sequences(truth.parent, results.parent, seqmap=seqmap)[0][0].steps) == 9
    short = write("short", "0000 empty 000000 000004\n")
    with pytest.raises(MetricError, match=r"b: sequence 0000 has 4 frames, but a box is in frame 4"):
        sequences(truth.parent, results.parent, seqmap=short)


def test_a_sequence_without_results(write, tmp_path):
    write("truth/0000.txt", kitti_text(2))
    write("truth/0001.txt", kitti_text(2))
    write("results/0001.txt", kitti_text(2, score=1))
    write("results/0009.txt", kitti_text(2, score=1))
    with pytest.raises(MetricError, match=r"results: no results for sequence 0000; .* --missing empty"):
        sequences(tmp_path / "truth", tmp_path / "results")
    found, pair = sequences(tmp_path / "truth", tmp_path / "results", missing="empty")
    assert [len(s.estimates) for s in found] == [0, 4]
    assert pair.notes == (
        "no truth for sequence 0009: left out [GT001]", "no results for sequence 0000: all of its truth is missed"
    )  # fmt: skip
    only, _ = sequences(tmp_path / "truth", tmp_path / "results", sequences=("0001",))
    assert [s.name for s in only] == ["0001"]
    with pytest.raises(ConfigError, match=r"--sequences 001: no such sequence; did you mean"):
        sequences(tmp_path / "truth", tmp_path / "results", sequences=("001",))


def test_no_truth_at_all_is_fatal(write, tmp_path):
    write("truth/0000.txt", kitti_text(2))
    write("results/0001.txt", kitti_text(2, score=1))
    with pytest.raises(MetricError, match=r"no truth for any sequence") as error:
        sequences(tmp_path / "truth", tmp_path / "results", sequences=("0001",))
    assert error.value.code == "GT001"


def test_single_files_belong_together_whatever_their_names_are(write):
    found, _ = sequences(write("truth.txt", kitti_text(2)), write("mine.txt", kitti_text(2, score=1)))
    assert [s.name for s in found] == ["truth"]


def test_empty_results_have_the_form_of_the_truth(write, tmp_path):
    write("truth/0000.txt", kitti_text(2))
    write("results/0000.txt", "")
    found, pair = sequences(tmp_path / "truth", tmp_path / "results")
    assert pair.estimates.form == "kitti-tracking"
    assert (len(found[0].truth), len(found[0].estimates)) == (4, 0)
    with pytest.raises(LogError, match="every file is empty, so its form can't be told; say --truth-format"):
        sequences(tmp_path / "results", tmp_path / "truth")


def test_ids_twice_in_a_frame(write):
    good = write("good.txt", kitti_text(2))
    bad = write("bad.txt", kitti_row(0, 1) + "\n" + kitti_row(4, 2) + "\n" + kitti_row(4, 2, x=3) + "\n")
    for pair in ((good, bad), (bad, good)):
        with pytest.raises(MetricError, match=r"bad.txt, sequence \w+: id 2 twice in frame 4") as error:
            sequences(*pair)
        assert error.value.code == "GT003"
    regions = write("regions.txt", "\n".join([kitti_row(0, -1, "DontCare")] * 2) + "\n")
    assert len(sequences(regions, good)[0][0].truth) == 2


def test_each_class_may_have_ids_of_its_own(write):
    """As where a tracker runs for cars and for pedestrians, one after the other."""
    both = write("both.txt", "\n".join(kitti_row(0, 1, name) for name in ("Car", "Pedestrian")) + "\n")
    found, _ = sequences(both, both)
    assert (len(found[0].truth), len(found[0].estimates)) == (2, 2)


def test_solids_of_zeros_are_none(write):
    """As converters of boxes in images write them, in truth too."""
    flat = write("flat.txt", "0 1 Car 0 0 -10 100 100 150 160 0 0 0 0 0 0 0\n")
    found, pair = sequences(flat, flat)
    assert (len(found[0].truth), pair.faults.counts) == (1, {})
    assert found[0].truth.center_m is None


@pytest.mark.parametrize("wrong", ["nan", "inf", "1e300"])
def test_boxes_that_arent_finite_are_counted(wrong, write):
    text = kitti_text(2)
    bad = write("bad.txt", text.replace(" 10.0 ", f" {wrong} ", 1))
    good = write("good.txt", text)
    found, pair = sequences(bad, good)
    assert (len(found[0].truth), found[0].num_invalid_truth) == (3, 1)
    assert pair.faults.counts == {"GT004": 1}
    assert "1 of class 'car'" in pair.faults.places["GT004"][0]
    found, pair = sequences(good, bad)
    assert len(found[0].estimates) == 4
    assert pair.faults.counts == {"PRD001": 1}


def test_sizes_that_arent_positive_are_no_truth(write):
    bad = write("bad.txt", kitti_text(1).replace(" 4.0 ", " 0 ", 1))
    found, pair = sequences(bad, write("good.txt", kitti_text(1)))
    assert (len(found[0].truth), pair.faults.counts["GT004"]) == (1, 1)


def test_motchallenge(write, tmp_path):
    for name in ("MOT-A", "MOT-B"):
        write(f"train/{name}/gt/gt.txt", "1,1,10,20,30,40,1,1,1\n2,1,11,20,30,40,1,1,1\n")
        write(f"train/{name}/seqinfo.ini", "[Sequence]\nseqLength=5\n")
        write(f"tracker/{name}.txt", "1,7,10.5,20,30,40,0.9,-1,-1,-1\n")
    found, _ = sequences(tmp_path / "train", tmp_path / "tracker")
    assert [(s.name, len(s.steps)) for s in found] == [("MOT-A", 5), ("MOT-B", 5)]
    assert found[0].estimates.xyxy_px.tolist() == [[10.5, 20, 40.5, 60]]
    one, _ = sequences(tmp_path / "train/MOT-A", tmp_path / "tracker/MOT-A.txt")
    assert [s.name for s in one] == ["MOT-A"]
    write("tracker/MOT-A.txt", "6,7,10.5,20,30,40,0.9,-1,-1,-1\n")
    with pytest.raises(MetricError, match="tracker: sequence MOT-A has 5 frames, but a box is in frame 5"):
        sequences(tmp_path / "train", tmp_path / "tracker")


def test_pixels_of_motchallenge_count_from_1(write):
    truth = write("t.csv", f"{COLUMNS}\n0,pedestrian,1,,9,19,39,59\n")
    found, _ = sequences(truth, write("r.txt", "1,7,10,20,30,40,0.9,-1,-1,-1\n"))
    assert found[0].estimates.xyxy_px.tolist() == found[0].truth.xyxy_px.tolist()


def test_object_benchmark_is_one_sequence_of_images(write, tmp_path):
    row = kitti_row(0, 0).split(" ", 2)[2]
    write("truth/label_2/000003.txt", f"{row}\n")
    write("truth/label_2/000010.txt", "")
    write("results/data/000003.txt", f"{row} 0.5\n")
    write("results/data/000011.txt", f"{row} 0.5\n")
    found, pair = sequences(tmp_path / "truth", tmp_path / "results")
    assert (pair.truth.form, pair.estimates.form) == ("kitti", "kitti")
    assert found[0].steps.frame.tolist() == [3, 10]
    assert (found[0].estimates.step.tolist(), found[0].num_unlabeled) == ([0], 1)


def test_tables_by_column_and_by_file(write, tmp_path):
    rows = "0,car,1,,10,20,30,40\n2,car,1,,10,20,30,40\n"
    write("truth/b.csv", f"{COLUMNS}\n{rows}")
    write("truth/a.csv", f"{COLUMNS}\n{rows}")
    together = [f"b,{row}" for row in rows.splitlines()] + [f"a,{row}" for row in rows.splitlines()]
    results = write("results.csv", f"sequence,{COLUMNS}\n" + "\n".join(together) + "\n")
    found, _ = sequences(tmp_path / "truth", results)
    assert [(s.name, len(s.steps), len(s.estimates)) for s in found] == [("a", 3, 2), ("b", 3, 2)]
    found, _ = sequences(results, tmp_path / "truth")
    assert [s.name for s in found] == ["b", "a"]


def test_large_tables_give_the_same(write, monkeypatch):
    rows = [f"{name},{f},car,{i},,{10 + i},20,30,40" for f in range(3) for name in "ab" for i in range(2)]
    path = write("t.csv", f"sequence,{COLUMNS}\n" + "\n".join(rows) + "\n")
    small = [s.truth for s in sequences(path, path)[0]]
    monkeypatch.setattr("fbench.metrics.files.table._MAX_KEPT", 0)
    large = [s.truth for s in sequences(path, path)[0]]
    assert [a.xyxy_px.tolist() for a in small] == [b.xyxy_px.tolist() for b in large]
    assert [len(a) for a in small] == [6, 6]


def test_tables_with_stamps_say_which_frames_there_are(write):
    head = "stamp_ns,x,y,z,length,width,height,yaw,label,track_id,score"
    truth = write("t.csv", f"{head}\n1000000000,5,0,0,4,2,1.5,0,Car,a,\n1100000000,,,,,,,,,,\n")
    results = write("r.csv", f"{head}\n1003000000,5,0,0,4,2,1.5,0,car,7,0.5\n1500000000,5,0,0,4,2,1.5,0,car,7,0.5\n")
    found, _ = sequences(truth, results)
    one = found[0]
    assert one.steps.stamp_ns.tolist() == [1_000_000_000, 1_100_000_000]
    assert (one.truth.label.tolist(), one.estimates.step.tolist(), one.num_unlabeled) == (["car"], [0], 1)
    frames = write("f.csv", f"{COLUMNS}\n0,car,1,,10,20,30,40\n")
    with pytest.raises(ConfigError, match=r"t.csv has stamps, .*f.csv has frames; give both the same"):
        sequences(truth, frames)


def test_a_table_of_truth_against_results_of_kitti(write):
    head = "frame,x,y,z,length,width,height,yaw,label,track_id"
    row = "0,10,-1,-0.95,4,1.6,1.5,-1.67,car,1"
    found, pair = sequences(write("t.csv", f"{head}\n{row}\n"), write("r.txt", kitti_row(0, 5, score=1) + "\n"))
    assert (pair.truth.form, pair.estimates.form) == ("table", "kitti-tracking")
    np.testing.assert_allclose(found[0].truth.center_m, found[0].estimates.center_m)
    np.testing.assert_allclose(found[0].truth.yaw_rad, found[0].estimates.yaw_rad, atol=1e-3)
    world = write("w.csv", f"frame_id,{head}\nworld,{row}\n")
    with pytest.raises(ConfigError, match=r"boxes in 'world', those of .* in 'camera'; give both the same"):
        sequences(world, write("r.txt", kitti_row(0, 5, score=1) + "\n"))


def test_cameras_are_steps_and_streams(write):
    head = f"camera,{COLUMNS}"
    rows = "left,0,car,1,,10,20,30,40\nright,0,car,1,,10,20,30,40\nright,1,car,1,,10,20,30,40\n"
    found, _ = sequences(write("t.csv", f"{head}\n{rows}"), write("r.csv", f"{head}\n{rows}"))
    steps = found[0].steps
    assert (steps.camera, steps.stream.tolist()) == (("left", "right") * 2, [0, 1, 0, 1])
    assert found[0].truth.step.tolist() == [0, 1, 3]
    nameless = write("n.csv", f"{COLUMNS}\n0,car,1,,10,20,30,40\n")
    with pytest.raises(LogError, match=r"n.csv: a box without camera, though there are the cameras left, right; tell"):
        sequences(write("t.csv", f"{head}\n{rows}"), nameless)


def test_tables_say_what_they_know(write):
    head = f"{COLUMNS},ignore,occlusion,truncation,visibility,attribute,num_lidar_pts,num_radar_pts,vx,vy"
    truth = write("t.csv", f"{head}\n0,Car,1,0.5,1,2,3,4,true,2,0.5,0.75,parked,3,4,1,2\n0,Van,2,,5,6,7,8,,,,,,,,,\n")
    found = sequences(truth, truth)[0][0].truth
    assert found.label.tolist() == ["car", "van"]
    assert found.score.tolist() == [0.5, 0]
    assert found.ignore.tolist() == [True, False]
    assert (found.occlusion[0], found.truncation[0], found.visibility[0]) == (2, 0.5, 0.75)
    assert found.attribute.tolist() == ["parked", ""]
    assert found.num_points.tolist() == [7, -1]
    assert found.center_m is None


def sample(name="car", x=10.0, score=0.5, **more):
    box = {"translation": [x, 20.0, 1.0], "size": [1.8, 4.2, 1.5], "rotation": [1.0, 0, 0, 0], "velocity": [1.0, 0.0]}
    return box | {"detection_name": name, "detection_score": score, "attribute_name": ""} | more


def submission(results):
    return json.dumps({"meta": {}, "results": results})


def test_nuscenes_scenes(write):
    truth = {"a1": [sample(num_pts=3, ego_translation=[4.0, 2.0, 0.5])], "a2": [], "b1": [sample()]}
    write("samples.csv", "token,stamp_ns,scene,ego_x,ego_y,ego_z\na2,20,s1,,,\na1,10,s1,,,\nb1,15,s2,1,2,3\n")
    pair = write("t.json", submission(truth)), write("r.json", submission({"a1": [sample(x=11.0)], "b1": []}))
    found, _ = sequences(*pair)
    one, two = found
    assert (one.name, one.steps.stamp_ns.tolist(), two.name) == ("s1", [10, 20], "s2")
    assert one.ego_m[0].tolist() == [6, 18, 0.5]
    assert np.isnan(one.ego_m[1]).all()
    assert two.ego_m.tolist() == [[1, 2, 3]]
    assert one.truth.size_lwh_m.tolist() == [[4.2, 1.8, 1.5]]
    assert (one.truth.num_points.tolist(), one.truth.velocity_mps.tolist()) == ([3], [[1, 0, 0]])


def test_nuscenes_samples_of_no_scene_beside_others_are_refused(write):
    truth = write("t.json", submission({"a1": [sample()], "b1": [sample()]}))
    write("samples.csv", "token,stamp_ns,scene\na1,10,s1\nb1,15,\n")
    with pytest.raises(LogError, match=r"samples.csv: sample 'b1' has no scene, others have one"):
        sequences(truth, truth)


def test_nuscenes_without_a_table_of_samples(write):
    truth = write("t.json", submission({"x": [sample()], "y": [sample()]}))
    found, pair = sequences(truth, write("r.json", submission({"y": [sample()]})))
    assert found[0].estimates.step.tolist() == [1]
    assert not pair.truth.read("t").are_ordered
    with pytest.raises(LogError, match=r"r.json: sample 'z' isn't in .*t.json"):
        sequences(truth, write("r.json", submission({"z": [sample()]})))


@pytest.mark.parametrize("wrong", [{"size": [1, 2]}, {"rotation": [0, 0, 0, 0]}, {"translation": "here"}])
def test_wrong_samples_are_named(wrong, write):
    truth = write("t.json", submission({"1": [sample()]}))
    bad = write("r.json", submission({"1": [sample(), sample() | wrong]}))
    with pytest.raises(LogError, match=rf"r.json: sample '1' box 1: {next(iter(wrong))}"):
        sequences(truth, bad)


def test_samples_read_at_once_are_those_read_one_by_one(write):
    turned = {"rotation": [0.9, 0.1, -0.2, 0.3]}
    boxes = [sample(), sample(x=3.0) | turned]
    fast = sequences(*[write("t.json", submission({"1": boxes}))] * 2)[0][0].truth
    slow = sequences(*[write("s.json", submission({"1": [*boxes, sample() | {"velocity": None}]}))] * 2)[0][0].truth
    np.testing.assert_allclose(fast.yaw_rad, slow.yaw_rad[:2], atol=1e-12)
    assert fast.center_m.tolist() == slow.center_m[:2].tolist()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda w, t: t / "none", "no such file or folder"),
        (lambda w, t: w("empty/readme.md", "x").parent, "no files of boxes in it"),
        (lambda w, t: w("run/manifest.json", "{}").parent, "a run folder; score it by itself"),
        (lambda w, t: w("a.txt", "hello world\n"), "no form of boxes that fbench knows"),
        (lambda w, t: w("a.csv", "frame,left\n1,2\n"), "column 'top' is missing"),
        (lambda w, t: w("a.csv", ""), "say --truth-format"),
        (lambda w, t: w("a.json", "{"), "no form of boxes"),
    ],
)  # fmt: skip
def test_what_is_no_truth(make, told, write, tmp_path):
    with pytest.raises(FbenchError, match=told):
        open_source(make(write, tmp_path), None, is_truth=True)


def test_mixed_forms_in_a_folder(write):
    write("mixed/0000.txt", kitti_text(1))
    folder = write("mixed/0001.txt", "1,1,10,20,30,40,1,1,1\n").parent
    with pytest.raises(LogError, match=r"0000.txt is 'kitti-tracking', but 0001.txt is 'mot'; one folder, one form"):
        open_source(folder, None, is_truth=True)
    write("both/0000.txt", kitti_text(1))
    folder = write("both/a.csv", COLUMNS).parent
    with pytest.raises(LogError, match="texts and tables in one folder"):
        open_source(folder, None, is_truth=True)


def test_unknown_forms(write):
    path = write("0000.txt", kitti_text(1))
    with pytest.raises(ConfigError, match=r"'kiti' is no form of boxes that can be scored; did you mean 'kitti'"):
        open_source(path, "kiti", is_truth=True)


@pytest.mark.parametrize(
    ("text", "told"),
    [("", "lists no sequence"), ("0000 1\n", "line 1: 2 columns, expected"), ("a\na\n", "line 2: sequence 'a' twice")],
)
def test_wrong_seqmaps(text, told, write):
    truth = write("t/0000.txt", kitti_text(1)).parent
    with pytest.raises(LogError, match=told):
        sequences(truth, truth, seqmap=write("seqmap", text))
    with pytest.raises(ConfigError, match=r"--seqmap .*: no such file"):
        sequences(truth, truth, seqmap=truth / "none")
