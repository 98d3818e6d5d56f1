"""Tracking alone, on recorded detections."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.frames import assert_equal, rig

from fbench.pipelines.variants.recorded import Track, TrackParams
from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.plugins import default_params
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import LogInfo

MS = 1_000_000


class Log:
    """Implements `BoxReader`."""

    poses = ()

    def __init__(self, results):
        self._results = results

    def body_poses(self):
        yield from ()

    def detections(self, topic):
        yield from self._results


def cars(x, score=0.9):
    num = len(x)
    center = np.column_stack([np.asarray(x, np.float64), np.zeros(num), np.zeros(num)])
    size = np.tile([4.0, 1.8, 1.6], (num, 1))
    return Boxes3D(center, size, np.zeros(num), label=np.full(num, "car"), score=np.full(num, score))


def flat(x):
    xyxy = np.column_stack([x, np.full(len(x), 10.0), np.add(x, 20.0), np.full(len(x), 30.0)])
    return Boxes2D(np.full(len(x), "cam"), xyxy, label=np.full(len(x), "car"), score=np.full(len(x), 0.9))


def run(found, **params):
    results = [
        Truth((i + 1) * 100 * MS, (i + 1) * 100 * MS, *((None, b) if isinstance(b, Boxes2D) else (b, None)))
        for i, b in enumerate(found)
        if b is not None
    ]
    pipeline = Track(TrackParams(**params))
    pipeline.use_log(Log(results))
    pipeline.start(rig("cam", "lidar"), LogInfo("log", "id"))
    pipeline.reset("start")
    return [pipeline.step(Frame(i, (i + 1) * 100 * MS, 0, {})) for i in range(len(found))]


def ids(outputs):
    return [output.tracks.track_id.tolist() for output in outputs]


def test_recorded_detections_become_tracks():
    found = [cars([10.0 + 0.5 * i, 40.0]) for i in range(5)]
    outputs = run(found)
    assert ids(outputs) == [[1, 2]] * 5
    for boxes, output in zip(found, outputs, strict=True):
        assert_equal(output.detections, boxes)
        assert list(output.stage_ns) == ["read", "track"]
    assert outputs[-1].tracks.velocity_mps[0, 0] == pytest.approx(5, abs=0.3)


def test_boxes_in_images_are_tracked_there():
    outputs = run([flat([10.0 + 2 * i, 70.0]) for i in range(5)])
    assert ids(outputs) == [[1, 2]] * 5
    assert isinstance(outputs[0].tracks, Boxes2D)


@pytest.mark.parametrize("make", [cars, flat])
def test_the_order_of_detections_changes_nothing(make):
    rng = np.random.default_rng(5)
    found = [make(np.concatenate([rng.uniform(0, 60, 12), [30.0, 30.0]])) for _ in range(12)]
    found = [replace(boxes, score=rng.choice([0.2, 0.7, 0.9], len(boxes))) for boxes in found]
    mixed = [boxes[rng.permutation(len(boxes))] for boxes in found]
    for output, other in zip(run(found), run(mixed), strict=True):
        assert list(output.tracks.arrays()) == list(other.tracks.arrays())
        for name, values in output.tracks.arrays().items():
            np.testing.assert_array_equal(values, other.tracks.arrays()[name])


def test_frames_without_a_result_are_bridged_and_say_so():
    outputs = run([cars([10.0]), cars([10.0]), None, cars([10.0])])
    assert ids(outputs) == [[1]] * 4
    assert outputs[2].missing == {"results": "no output within 50 ms"}
    assert len(outputs[2].detections) == 0
    assert (outputs[2].tracks.predicted.tolist(), outputs[2].tracks.score.tolist()) == ([True], [0.0])


def test_empty_frames_and_what_is_no_box():
    bad = cars([10.0, np.nan, 20.0, 30.0])
    bad = replace(bad, score=np.array([0.9, 0.9, np.nan, 0.9]), size_lwh_m=np.array([[4, 2, 1.5]] * 3 + [[np.inf] * 3]))
    outputs = run([cars([]), bad, bad, cars([])])
    assert ids(outputs) == [[], [], [1], [1]]
    assert len(outputs[1].detections) == 4
    assert [output.tracks.label.tolist() for output in outputs[2:]] == [["car"], ["car"]]


def test_many_equal_detections():
    outputs = run([cars([5.0] * 300)] * 3)
    assert [len(output.tracks) for output in outputs] == [300] * 3
    assert ids(outputs)[2] == list(range(1, 301))


def test_detections_count_on_every_third_frame_and_tracks_are_predicted_between():
    found = [cars([10.0 + 1.0 * i]) for i in range(10)]
    outputs = run(found, detect_every=3)
    assert ids(outputs) == [[1]] * 10
    assert [bool(output.tracks.predicted[0]) for output in outputs] == [i % 3 != 0 for i in range(10)]
    for i in (7, 8):
        assert_equal(outputs[i].detections, outputs[i].tracks)
        assert outputs[i].tracks.center_m[0, 0] == pytest.approx(10 + i, abs=0.4)
    assert_equal(outputs[9].detections, found[9])


def test_a_segment_ends_all_tracks():
    pipeline = Track()
    pipeline.use_log(Log([Truth(i * 100 * MS, i * 100 * MS, cars([10.0])) for i in (1, 2, 3)]))
    pipeline.start(rig("lidar"), LogInfo("log", "id"))
    shown = []
    for i in (1, 2, 3):
        pipeline.reset("gap")
        shown += pipeline.step(Frame(i, i * 100 * MS, 0, {})).tracks.track_id.tolist()
    assert shown == [1, 2, 3]


def test_what_it_needs():
    with pytest.raises(ConfigError, match="pipeline 'track' reads results from a log, and got none"):
        Track().start(rig("lidar"), LogInfo("log", "id"))
    with pytest.raises(ConfigError, match="pipeline 'track' wasn't started"):
        Track().step(Frame(0, 0, 0, {}))
    with pytest.raises(LogError, match="holds no result that can be used"):
        run([None])
    with pytest.raises(ConfigError, match="detect_every: expected at least 1, got 0"):
        TrackParams(detect_every=0)


def test_parameters_are_told_and_set():
    params = default_params(load("pipelines", "track"))
    changed = apply_settings(params, ["tracking.association=mahalanobis", "tracking2d.min_iou=0.3", "topic=/boxes"])
    assert (changed.tracking.association, changed.tracking2d.min_iou, changed.topic) == ("mahalanobis", 0.3, "/boxes")
    with pytest.raises(ConfigError, match=r"tracking\.min_giou: expected between -1 and 1, got -2"):
        apply_settings(params, ["tracking.min_giou=-2"])
