"""MOTChallenge: results and truth."""

import configparser

import numpy as np
import pytest
from tests.replay.formats.exports import exported, flats, read, run_of, solids, stamp, sweeps, write_log

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import Truth


def test_results_by_hand(tmp_path):
    """Pixels and frames count from 1."""
    run = run_of(
        write_log(tmp_path / "a.mcap", sweeps(3)), lambda i: flats(i, score=[0.5] * i, track_id=range(4, 4 + i))
    )
    exported("mot", tmp_path / "out", run)
    assert (tmp_path / "out" / "a.txt").read_text() == (
        "2,4,1.0000,11.5000,40.0000,49.6250,0.500000,-1,-1,-1\n"
        "3,4,1.0000,11.5000,40.0000,49.6250,0.500000,-1,-1,-1\n"
        "3,5,101.2500,11.5000,40.0000,49.6250,0.500000,-1,-1,-1\n"
    )


def test_results_are_read_back(tmp_path):
    run = run_of(
        write_log(tmp_path / "a.mcap", sweeps(2)), lambda i: flats(3, score=[0.1, 0.2, 0.3], track_id=[9, 8, 7])
    )
    exported("mot", tmp_path / "out", run)
    for truth in read(tmp_path / "out" / "a.txt", "mot"):
        np.testing.assert_allclose(truth.boxes2d.xyxy_px, flats(3).xyxy_px, atol=1e-4)
        np.testing.assert_allclose(truth.boxes2d.score, [0.1, 0.2, 0.3])
        assert truth.boxes2d.track_id.tolist() == [9, 8, 7]


def test_boxes_in_3d_are_projected(tmp_path):
    run = run_of(write_log(tmp_path / "a.mcap", sweeps(1)), lambda i: solids([10.0, -10], track_id=[1, 2]))
    assert exported("mot", tmp_path / "out", run).left_out == {"not seen by cam": 1}
    numbers = (tmp_path / "out" / "a.txt").read_text().split(",")[2:6]
    np.testing.assert_allclose([float(v) for v in numbers], [522.25, 115.375, 157.5, 131.25])


def test_truth_is_read_back(tmp_path):
    """Ids of regions that are ignored are made up: in MOTChallenge all rows have one."""
    names, ids = ["pedestrian", "car", "reflection"], [5, 6, -1]
    flat = flats(3, source_label=names, ignore=[False, False, True], track_id=ids, visibility=[0.25, 1, np.nan])
    truths = [Truth(stamp(i), stamp(i), None, flat if i else flat[:0], i) for i in range(3)]
    exported("mot", tmp_path / "out", write_log(tmp_path / "a.mcap", [*sweeps(3), *truths]))
    info = configparser.ConfigParser()
    info.read_string((tmp_path / "out" / "a" / "seqinfo.ini").read_text())
    assert dict(info["Sequence"]) == {
        "name": "a", "imdir": "img1", "framerate": "10", "seqlength": "3", "imwidth": "1242", "imheight": "375",
        "imext": ".jpg",
    }  # fmt: skip
    back = read(tmp_path / "out" / "a", "mot")
    assert [len(truth.boxes2d) for truth in back] == [0, 3, 3]
    got = back[1].boxes2d
    np.testing.assert_allclose(got.xyxy_px, flat.xyxy_px, atol=1e-4)
    assert got.source_label.tolist() == ["pedestrian", "car", "distractor"]
    assert got.ignore.tolist() == [False, False, True]
    assert got.visibility.tolist() == [0.25, 1, 1]
    assert got.track_id.tolist() == [5, 6, 7]


def test_frames_are_counted_in_the_log_not_taken_from_its_numbers(tmp_path):
    flat = flats(1, source_label=["car"], track_id=[1])
    truths = [Truth(stamp(2), stamp(2), None, flat, 102)]
    exported("mot", tmp_path / "out", write_log(tmp_path / "a.mcap", [*sweeps(4, [100, 101, 102, 103]), *truths]))
    assert (tmp_path / "out" / "a" / "gt" / "gt.txt").read_text().startswith("3,1,")
    assert "seqLength=4\n" in (tmp_path / "out" / "a" / "seqinfo.ini").read_text()


def test_truth_needs_classes(tmp_path):
    boxes = flats(1, label=[""], track_id=[1])
    log = write_log(tmp_path / "a.mcap", [*sweeps(1), Truth(stamp(0), stamp(0), None, boxes, 0)])
    with pytest.raises(LogError, match="boxes without a class"):
        exported("mot", tmp_path / "out", log)
    exported("mot", tmp_path / "out", log, class_name="car")
    assert (tmp_path / "out" / "a" / "gt" / "gt.txt").read_text().endswith(",1,3,1.0000\n")


def test_truth_of_classes_without_a_place_is_counted(tmp_path):
    boxes = flats(3, track_id=[1, 2, 3], label=["car", "spaceship", "pedestrian"])
    log = write_log(tmp_path / "a.mcap", [*sweeps(1), Truth(stamp(0), stamp(0), None, boxes)])
    assert exported("mot", tmp_path / "out", log).left_out == {"of classes that MOTChallenge doesn't have": 1}
    rows = (tmp_path / "out/a/gt/gt.txt").read_text().splitlines()
    assert [row.split(",")[1] for row in rows] == ["1", "3"]
