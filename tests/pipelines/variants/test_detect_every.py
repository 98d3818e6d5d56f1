"""`detect_every`: what all pipelines do in frames in which nothing is looked for."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import JPEG, cloud, frame, image, rig, scan

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.trackers import Tracker2D
from fbench.pipelines.variants.camera2d import Camera2D, Camera2DParams
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.pipelines.variants.lidar import Lidar3D, Lidar3DParams
from fbench.pipelines.variants.radar import Radar3D, Radar3DParams
from fbench.pipelines.variants.stereo3d import Stereo3D, Stereo3DParams
from fbench.replay.contracts.entry_points import entry_points_of, load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.plugins import default_params
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.contracts.settings import apply_settings, parameter_paths
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo
from fbench.replay.runs.digest import digest

LOG = LogInfo("drive", "id")
NAMES = ("camera2d", "lidar3d", "radar3d", "late3d")
DETECTING = [name for name in entry_points_of("pipelines") if name not in ("exec", "recorded")]


def started(name: str, weights: Path, every: int) -> Pipeline:
    camera = CameraParams(weights=weights)
    made: dict[str, Callable[[], Pipeline]] = {
        "camera2d": lambda: Camera2D(Camera2DParams(camera, detect_every=every)),
        "lidar3d": lambda: Lidar3D(Lidar3DParams(detect_every=every)),
        "radar3d": lambda: Radar3D(Radar3DParams(detect_every=every)),
        "late3d": lambda: Late3D(Late3DParams(camera, detect_every=every, fusion=FusionParams(min_score=0.5))),
    }
    pipeline = made[name]()
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    return pipeline


def whole(index: int) -> Frame:
    return frame(index, image(), cloud(), scan())


def same(a: Output, b: Output) -> bool:
    return digest([a.detections, a.tracks]) == digest([b.detections, b.tracks])


@pytest.mark.parametrize("name", NAMES)
def test_between_detections_tracks_are_predicted_and_stand_for_detections(name: str, one_car: Path):
    pipeline, usual = started(name, one_car, 3), started(name, one_car, 1)
    outputs = [pipeline.step(whole(i)) for i in range(7)]
    assert same(outputs[0], usual.step(whole(0)))
    for i, output in enumerate(outputs):
        if i % 3 == 0:
            assert output.detections.predicted is None
            assert len(output.stage_ns) > 1
            continue
        assert output.detections is output.tracks
        assert len(output.tracks) == len(outputs[0].tracks) > 0
        assert output.tracks.predicted is not None
        assert output.tracks.predicted.all()
        assert list(output.stage_ns) == ["track"]
    assert outputs[6].tracks.track_id.tolist() == outputs[0].tracks.track_id.tolist()


@pytest.mark.parametrize("name", NAMES)
def test_what_is_wrong_with_a_frame_in_between_is_not_met(name: str, one_car: Path):
    pipeline, other = started(name, one_car, 2), started(name, one_car, 2)
    first, second = whole(0), frame(1, image(JPEG[:100]))
    pipeline.step(first)
    other.step(first)
    output = pipeline.step(second)
    assert (output.faults, output.missing) == ((), {})
    assert same(output, other.step(whole(1)))
    assert same(pipeline.step(whole(2)), other.step(whole(2)))


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_without_sensors_is_due_all_the_same(name: str, one_car: Path):
    pipeline = started(name, one_car, 2)
    outputs = [pipeline.step(f) for f in (whole(0), whole(1), frame(2), whole(3), whole(4))]
    assert len(outputs[2].detections) == 0
    assert outputs[3].tracks.predicted is not None
    assert outputs[3].tracks.predicted.all()
    assert len(outputs[4].detections) == len(outputs[0].detections)


@pytest.mark.parametrize("name", NAMES)
def test_a_segment_begins_with_a_detection(name: str, one_car: Path):
    pipeline = started(name, one_car, 3)
    for i in range(2):
        pipeline.step(whole(i))
    pipeline.reset("gap")
    output = pipeline.step(whole(50))
    assert len(output.stage_ns) > 1
    assert len(output.detections) > 0


def test_cameras_without_weights_are_missing_in_every_frame():
    pipeline = Late3D(Late3DParams(detect_every=2))
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    assert [pipeline.step(whole(i)).missing for i in range(2)] == [{"cam": "no weights"}] * 2


def test_stereo_too():
    from tests.pipelines.sensors.stereo.pairs import car, road, wall
    from tests.pipelines.sensors.stereo.pairs import frame as pair
    from tests.pipelines.sensors.stereo.pairs import rig as two

    pipeline = Stereo3D(apply_settings(Stereo3DParams(), ["stereo.disparity.shrink=1", "detect_every=2"]))
    pipeline.start(two(), LOG)
    scene = [road(), wall(30.0), *car(9.0, 1.0)]
    first, second = pipeline.step(pair(two(), scene)), pipeline.step(pair(two(), scene, noise=30.0, index=1))
    assert len(first.detections) == len(second.detections) == 1
    assert (second.missing, list(second.stage_ns)) == ({}, ["track"])


@pytest.mark.parametrize("name", DETECTING)
def test_every_pipeline_that_detects_or_tracks_has_it(name: str):
    params = default_params(load("pipelines", name))
    assert "detect_every" in parameter_paths(params)
    assert params.detect_every == 1
    with pytest.raises(ConfigError, match="detect_every: expected at least 1, got 0"):
        apply_settings(params, ["detect_every=0"])


def test_distance_in_images_moves_by_range_rate_while_predicted():
    tracker = Tracker2D(Tracker2DParams())
    boxes = Boxes2D(
        np.array(["cam"]), np.array([[10.0, 10, 50, 50]]), score=np.ones(1), distance_m=np.array([30.0]),
        range_rate_mps=np.array([-8.0]),
    )  # fmt: skip
    tracker.step(boxes, 0)
    shown = [tracker.predict(i * 100_000_000).distance_m[0] for i in (1, 2, 3)]
    assert shown == pytest.approx([29.2, 28.4, 27.6])
    again = tracker.step(replace(boxes, distance_m=np.array([26.9])), 400_000_000)
    assert (again.distance_m.tolist(), again.track_id.tolist()) == ([26.9], [1])
