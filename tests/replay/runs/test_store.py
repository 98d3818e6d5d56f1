"""Run folders: tables of boxes read back as they were, damage is found."""

import dataclasses
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.replay.fakes import Echo, drive

from fbench.replay.contracts.errors import MetricError, RunError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import Score, load_scores, save_scores
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxWriter, read_boxes

floats = st.floats(width=64)


def some(n):
    number = arrays(np.float64, n, elements=floats)
    text = st.lists(
        st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=5), min_size=n, max_size=n
    ).map(lambda v: np.array(v, np.str_))
    optional = {
        "velocity_mps": arrays(np.float64, (n, 3), elements=floats), "label": text, "score": number,
        "track_id": arrays(np.int64, n), "sources": arrays(np.uint8, n), "predicted": arrays(np.bool_, n),
        "source_label": text,
    }  # fmt: skip
    three = arrays(np.float64, (n, 3), elements=floats)
    return st.fixed_dictionaries({"center_m": three, "size_lwh_m": three, "yaw_rad": number}, optional=optional)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(st.integers(1, 4).flatmap(some))
def test_boxes_survive_bit_for_bit(tmp_path, fields):
    boxes = Boxes3D(**fields)
    writer = BoxWriter(tmp_path / "t.parquet", Boxes3D)
    writer.add(3, boxes)
    writer.add(5, boxes[:0])
    writer.close()
    back = read_boxes(tmp_path / "t.parquet")
    assert set(back.boxes.arrays()) == set(boxes.arrays())
    for name, array in boxes.arrays().items():
        again = back.at(3).arrays()[name]
        if array.dtype.kind == "U":
            assert again.tolist() == array.tolist()
        else:
            assert again.dtype == array.dtype
            assert again.tobytes() == np.ascontiguousarray(array).tobytes()
    assert len(back.at(4)) == len(back.at(5)) == 0


def test_2d_boxes_and_partly_absent_fields(tmp_path):
    writer = BoxWriter(tmp_path / "t.parquet", Boxes2D)
    with_distance = Boxes2D(np.array(["a", "b"]), np.ones((2, 4)), distance_m=np.array([1.0, np.nan]))
    writer.add(0, with_distance)
    writer.add(1, Boxes2D(np.array(["c"]), np.zeros((1, 4))))
    writer.close()
    back = read_boxes(tmp_path / "t.parquet")
    assert back.boxes.camera.tolist() == ["a", "b", "c"]
    np.testing.assert_array_equal(back.boxes.distance_m, [1, np.nan, np.nan])
    assert back.boxes.label is None


def test_empty_table_reads_as_no_boxes(tmp_path):
    BoxWriter(tmp_path / "t.parquet", Boxes3D).close()
    assert len(read_boxes(tmp_path / "t.parquet").at(0)) == 0


@pytest.fixture
def folder(tmp_path):
    return replay(drive(4), Plan(Echo(), "echo"), tmp_path / "run", FaultLog())


def test_no_damage_to_a_table_goes_unnoticed(folder):
    path = folder / "detections.parquet"
    data, whole = path.read_bytes(), Run(folder).detections.boxes.center_m.tobytes()
    end_of_pages = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    found = 0
    for at in range(4, end_of_pages, 11):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        try:
            unharmed = Run(folder).detections.boxes.center_m.tobytes() == whole
        except RunError:
            found += 1
        else:
            assert unharmed
    assert found > 20


def test_table_of_another_kind_is_refused(folder):
    (folder / "detections.parquet").write_bytes((folder / "frames.parquet").read_bytes())
    with pytest.raises(RunError, match=r"detections.parquet: can't be read \(not a table of boxes\)"):
        _ = Run(folder).detections


def test_runs_of_before_digests_of_stages_are_read(folder):
    path = folder / "frames.parquet"
    frames = Run(folder).frames
    pq.write_table(pq.read_table(path).drop_columns("stages"), path)
    assert Run(folder).frames == tuple(dataclasses.replace(frame, stages={}) for frame in frames)


def test_what_is_no_run_says_so(folder, tmp_path):
    with pytest.raises(RunError, match=r"not a run folder \(no manifest.json\)"):
        _ = Run(tmp_path).manifest
    with pytest.raises(RunError, match="no scores, run `fbench score"):
        _ = Run(folder).scores
    manifest = folder / "manifest.json"
    content = json.loads(manifest.read_text())
    manifest.write_text(json.dumps({**content, "surprise": 1}))
    with pytest.raises(RunError, match="not a manifest of this version"):
        _ = Run(folder).manifest
    manifest.write_text("{")
    with pytest.raises(RunError, match="not a manifest of this version"):
        _ = Run(folder).manifest


def test_scores_round_trip_and_refuse_nan(tmp_path):
    rows = [
        Score("f1", "vehicle", "all", "bev 2 m", 0.5, None, "1", {"tp": 1}),
        Score("mota", "vehicle", "all", "bev 2 m", None, "no truth", "1"),
    ]
    save_scores(tmp_path / "scores.json", rows)
    assert load_scores(tmp_path / "scores.json") == rows
    with pytest.raises(MetricError, match="isn't a number"):
        Score("f1", "vehicle", "all", "m", float("nan"), None, "1")
    with pytest.raises(MetricError, match="a reason goes with null"):
        Score("f1", "vehicle", "all", "m", None, None, "1")
    (tmp_path / "scores.json").write_text('{"a": 1}')
    with pytest.raises(RunError, match="not a list of scores"):
        load_scores(tmp_path / "scores.json")


def test_fields_of_boxes_are_known_without_a_single_box(tmp_path):
    writer = BoxWriter(tmp_path / "t.parquet", Boxes3D)
    writer.add(0, Boxes3D(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), label=np.zeros(0, "U3")))
    writer.close()
    boxes = read_boxes(tmp_path / "t.parquet").boxes
    assert boxes.label is not None
    assert boxes.score is None


def test_truth_in_one_space_is_not_empty_truth_in_the_other(tmp_path):
    labels = [Truth(0, 0, Boxes3D.empty()), Truth(100_000_000, 0, None, Boxes2D.empty())]
    log = drive(3)
    log.labels = labels
    run = Run(replay(log, Plan(Echo(), "echo"), tmp_path / "run", FaultLog()))
    assert [run.truth3d(i) is not None for i in range(3)] == [True, False, False]
    assert [run.truth2d(i) is not None for i in range(3)] == [False, True, False]
