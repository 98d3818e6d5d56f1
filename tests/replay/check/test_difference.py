"""Which field differs first."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.replay.fakes import MS, Echo, box, cloud, drive

from fbench.replay.check.difference import (
    WATCH,
    Outcome,
    WatchedPipeline,
    WatchedReader,
    boxes_difference,
    first_difference,
)
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.scores import save_scores
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan


def four(**fields):
    one = box(1.0)
    arrays = {name: np.repeat(values, 4, axis=0) for name, values in one.arrays().items()}
    return Boxes3D(**{**arrays, **fields})


SCORES = np.array([0.5, 0.6, 0.7, 0.81])


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (four(), four(), None),
        (four(score=SCORES), four(score=np.array([0.5, 0.6, 0.7, 0.82])), "score[3] 0.81 != 0.82"),
        (four(score=np.full(4, np.nan)), four(score=np.full(4, np.nan)), None),
        (four(yaw_rad=np.array([0, 0, 0, np.nan])), four(), "yaw_rad[3] nan != 0.0"),
        (four(center_m=np.zeros((4, 3))), four(center_m=np.eye(4, 3)), "center_m[0, 0] 0.0 != 1.0"),
        (four(), four()[:3], "4 Boxes3D != 3 Boxes3D"),
        (Boxes3D.empty(), Boxes2D.empty(), "0 Boxes3D != 0 Boxes2D"),
        (four(), four(track_id=np.arange(4)), "track_id absent != present"),
        (four(label=np.array(["car"] * 4)), four(label=np.array(["car", "van"] * 2)), "label[1] 'car' != 'van'"),
    ],
)
def test_boxes(a, b, expected):
    assert boxes_difference(a, b) == expected


def outcome(log, folder, pipeline=None):
    reader = WatchedReader(log)
    watched = WatchedPipeline(pipeline or Echo(), reader)

    def complete(partial):
        (partial / WATCH).write_text(json.dumps(watched.rows))
        save_scores(partial / "scores.json", [])

    return Outcome(replay(reader, Plan(watched, "p"), folder, FaultLog(), complete=complete))


def changed(change):
    log = drive()
    change(log)
    return log


def flip_one_bit(log):
    cloud_ = log.items[14]
    bits = cloud_.xyz.copy()
    bits.view(np.uint32)[1, 2] ^= 1
    log.items[14] = replace(cloud_, xyz=bits)


class Off(Echo):
    """Wrong in the tracks of frame 3 alone."""

    def step(self, frame):
        output = super().step(frame)
        wrong = replace(output.tracks, track_id=output.tracks.track_id + 5)
        return replace(output, tracks=wrong) if frame.index == 3 else output


@pytest.mark.parametrize(
    ("change", "pipeline", "expected"),
    [
        (lambda log: None, None, None),
        (lambda log: None, Off(), "frame 3, tracks: track_id[0] 4 != 9"),
        (flip_one_bit, None, "frame 7, messages: lidar.content '"),
        (lambda log: log.items.pop(15), None, "frame 7, frames: radar.stamp_ns 700000000 != None"),
        (lambda log: log.items.pop(), None, "frame 19, frames: radar.stamp_ns 1900000000 != None"),
        (lambda log: log.items.pop(0), None, "frame 0, frames: stamp_ns 0 != 100000000"),
        (lambda log: log.labels.pop(), None, "frame 18, frames: truth_stamp_ns 1800000000 != None"),
        (
            lambda log: log.items.append(cloud(450 * MS, sensor="sonar")),
            None,
            "frame 5, messages: what was read until then differs",
        ),
    ],
)
def test_first_difference_of_two_runs(tmp_path, change, pipeline, expected):
    a, b = outcome(drive(), tmp_path / "a"), outcome(changed(change), tmp_path / "b", pipeline)
    found = first_difference(a, b, same_container=True)
    assert (found is None) if expected is None else str(found).startswith(expected)
    assert (a.digests == b.digests) == (expected is None)


def test_one_flipped_bit_changes_exactly_its_frame(tmp_path):
    a, b = outcome(drive(), tmp_path / "a"), outcome(changed(flip_one_bit), tmp_path / "b")
    parts = [a.inputs[i]["parts"] == b.inputs[i]["parts"] for i in range(20)]
    assert [i for i, same in enumerate(parts) if not same] == [7]
    chains = [a.inputs[i]["messages"] == b.inputs[i]["messages"] for i in range(20)]
    assert chains.index(False) in (6, 7)


def test_faults_of_the_container_may_differ_between_containers(tmp_path):
    a, b = outcome(drive(), tmp_path / "a"), outcome(drive(), tmp_path / "b")
    faults = b.run.json("faults.json")
    next(row for row in faults["rows"] if row["code"] == "LOG006").update(count=3)
    (b.run.folder / "faults.json").write_text(json.dumps(faults))
    assert first_difference(a, b, same_container=False) is None
    assert str(first_difference(a, b, same_container=True)) == "faults: LOG006 [0, []] != [3, []]"
