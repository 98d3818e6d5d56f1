"""late2d with a stereo pair: what it adds without a LiDAR and beside one, and when it is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.conftest import Model
from tests.pipelines.frames import UPRIGHT
from tests.pipelines.frames import rig as plain_rig
from tests.pipelines.sensors.stereo.pairs import HEIGHT_M, car, frame, rig, road, wall

from fbench.pipelines.variants.late import Late2D, Late2DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig

LOG = LogInfo("drive", "id")
PAIR = rig()
SCENE = [road(), wall(30.0), *car(9.0, 1.0)]
OUTLINE = [160.0, 141.0, 204.0, 176.0]
"""The back of the car in the left image, f = 200 px: 0.1 to 1.9 m to the left of the middle, whose camera is 0.2 m to
the left, 1.5 m high under a camera at 1.2 m, down to the road; 2 px wider."""
NO_WEIGHTS = ("left.weights=none", "right.weights=none")
BOTH = {"left": "stereo depth is noise", "right": "stereo depth is noise"}


@pytest.fixture(scope="module")
def pictures() -> Frame:
    return frame(PAIR, SCENE)


@pytest.fixture
def faint_car(constant_model: Model) -> Path:
    """A detector that sees the car in every image, with a score that isn't reported alone."""
    outputs = {
        "labels": np.array([[2]], np.int64),
        "boxes": np.array([[[161, 142, 204, 177]]], np.float32),
        "scores": np.array([[0.4]], np.float32),
    }
    inputs = {"images": ("float32", (1, 3, 32, 32)), "orig_target_sizes": ("int64", (1, 2))}
    return constant_model(outputs, inputs)


def started(sensors: Rig, *settings: str) -> Late2D:
    pipeline = Late2D(apply_settings(Late2DParams(), ["stereo.disparity.shrink=1", *settings]))
    pipeline.start(sensors, LOG)
    return pipeline


def with_lidar() -> Rig:
    return Rig({**PAIR.mounts, "lidar": Mount("lidar", np.array([0, 0, HEIGHT_M]), UPRIGHT)}, PAIR.cameras)


def measure(seen: Frame, *, ahead: bool) -> Frame:
    """Add the points of a LiDAR with beams of 0.5 degrees, `ahead` to the scene, or to the road behind."""
    azimuth, elevation = (a.ravel() for a in np.radians(np.mgrid[-50:50:0.5, -25:10:0.5]))
    up, away = np.tan(elevation), np.stack([np.cos(azimuth), np.sin(azimuth)])
    reach = np.where(up < 0, HEIGHT_M / np.maximum(-up, 1e-9), 1e3)  # to the road
    if ahead:
        for x_m, low, high in ((9.0, (0.1, 0.2), (1.9, 1.5)), (30.0, (-100, -100), (100, 100))):
            there = x_m / away[0]
            y, z = there * away[1], HEIGHT_M + there * up
            is_hit = (y > low[0]) & (y < high[0]) & (z > low[1]) & (z < high[1])
            reach = np.where(is_hit, np.minimum(reach, there), reach)
    xyz = np.stack([*(reach * away), reach * up], axis=1)[reach < 60].astype(np.float32)
    points = PointCloud("lidar", 0, 0, xyz if ahead else xyz * np.array([-1, -1, 1], np.float32))
    return replace(seen, messages={**seen.messages, "lidar": points})


def require_equal(one: Output, other: Output) -> None:
    for boxes, others in ((one.detections, other.detections), (one.tracks, other.tracks)):
        assert boxes.arrays().keys() == others.arrays().keys()
        for name, values in boxes.arrays().items():
            np.testing.assert_array_equal(values, others.arrays()[name])


def of_left(output: Output) -> Boxes2D:
    assert isinstance(output.detections, Boxes2D)
    return output.detections[output.detections.camera == "left"]


def test_stereo_alone_finds_the_car(pictures: Frame):
    pipeline = started(PAIR)
    assert pipeline.required_sensors() == pipeline.used_sensors() == ("left", "right")
    output = pipeline.step(pictures)
    seen = of_left(output)
    assert seen.xyxy_px[0] == pytest.approx(OUTLINE, abs=3)
    assert (seen.label.tolist(), seen.sources.tolist()) == (["car"], [8])
    assert seen.distance_m[0] == pytest.approx(11.2, abs=0.5)
    # The error of depth is 9^2 / (200 * 0.4) * 0.1 = 0.10 m, so the evidence counts 1 / (1 + (0.10 / 0.3)^2) = 0.9:
    # log-odds of -0.85 (prior 0.3) + 0.9 * 1.69 (0.7 against it) are 0.66.
    assert seen.score[0] == pytest.approx(0.66, abs=0.02)
    assert output.missing == {"left": "no weights", "right": "no weights"}
    assert {"decode", "preprocess", "detect.stereo", "fuse", "track"} <= output.stage_ns.keys()


def test_a_faint_box_of_a_camera_counts_where_stereo_confirms_it(pictures: Frame, faint_car: Path):
    settings = (f"camera.weights={faint_car}", "right.weights=none")
    alone = started(with_lidar(), "stereo_pair=off", *settings).step(pictures)
    assert len(alone.detections) == 0
    seen = of_left(started(PAIR, *settings).step(pictures))
    assert seen.sources.tolist() == [9]
    assert seen.xyxy_px[0] == pytest.approx(OUTLINE, abs=3)


def test_where_a_lidar_measured_stereo_changes_nothing(pictures: Frame, faint_car: Path):
    seen, settings = measure(pictures, ahead=True), (f"camera.weights={faint_car}", "right.weights=none")
    on, off = (started(with_lidar(), f"stereo_pair={way}", *settings).step(seen) for way in ("on", "off"))
    assert of_left(off).sources.tolist() == [3]
    require_equal(on, off)


def test_where_a_lidar_measured_nothing_stereo_counts(pictures: Frame):
    pipeline = started(with_lidar(), "stereo_pair=on", *NO_WEIGHTS)
    assert pipeline.used_sensors() == ("left", "lidar", "right")
    seen = of_left(pipeline.step(measure(pictures, ahead=False)))
    assert seen.sources.tolist() == [8]
    assert seen.xyxy_px[0] == pytest.approx(OUTLINE, abs=3)


def test_beside_a_lidar_the_pair_is_used_only_on_request(pictures: Frame):
    auto = started(with_lidar(), *NO_WEIGHTS)
    assert auto.used_sensors() == ("lidar",)
    assert len(auto.step(pictures).detections) == 0


def test_noise_switches_stereo_off_and_says_so(pictures: Frame):
    noisy = frame(PAIR, SCENE, noise=30.0)
    pipeline = started(PAIR, *NO_WEIGHTS)
    full = pipeline.step(pictures)
    pipeline.reset("again")
    output = pipeline.step(noisy)
    assert (len(output.detections), output.missing) == (0, BOTH)
    assert output.detections.arrays().keys() == full.detections.arrays().keys()
    on, off = (
        started(with_lidar(), f"stereo_pair={way}", *NO_WEIGHTS).step(measure(noisy, ahead=True))
        for way in ("on", "off")
    )
    assert of_left(off).sources.tolist() == [2]
    require_equal(on, off)
    assert BOTH.items() <= on.missing.items()


def test_a_corrupt_image_is_one_fault_and_the_rest_goes_on(pictures: Frame, faint_car: Path):
    bad = Image("left", 0, 0, encode_jpeg(np.zeros((300, 400, 3), np.uint8))[:50], "jpeg", (400, 300))
    seen = measure(replace(pictures, messages={**pictures.messages, "left": bad}), ahead=True)
    output = started(with_lidar(), "stereo_pair=on", f"camera.weights={faint_car}").step(seen)
    assert [(fault.code, fault.where) for fault in output.faults] == [("DEC002", "left at stamp 0")]
    assert of_left(output).sources.tolist() == [2]


@pytest.mark.parametrize("present", [(), ("left",), ("right",), ("lidar",), ("left", "lidar"), ("left", "right")])
def test_any_subset_of_messages(pictures: Frame, present: tuple[str, ...]):
    pipeline, full = started(with_lidar(), "stereo_pair=on", *NO_WEIGHTS), measure(pictures, ahead=True)
    whole = pipeline.step(full)
    pipeline.reset("again")
    output = pipeline.step(replace(full, messages={name: full.messages[name] for name in present}))
    assert output.detections.arrays().keys() == whole.detections.arrays().keys()
    assert output.faults == ()
    expected = [2] if "lidar" in present else [8] if "right" in present and "left" in present else []
    assert of_left(output).sources.tolist() == expected


def test_the_order_of_messages_and_points_changes_nothing_nor_does_another_run(pictures: Frame, faint_car: Path):
    seen = measure(pictures, ahead=False)
    points = seen.messages["lidar"]
    assert isinstance(points, PointCloud)
    other = replace(points, xyz=np.random.default_rng(0).permutation(points.xyz))
    turned = replace(seen, messages=dict(reversed({**seen.messages, "lidar": other}.items())))
    settings = ("stereo_pair=on", f"camera.weights={faint_car}")
    first = started(with_lidar(), *settings).step(seen)
    assert of_left(first).sources.tolist() == [9]
    for again in (seen, turned):
        require_equal(first, started(with_lidar(), *settings).step(again))


def test_a_pair_that_is_asked_for_must_be_there():
    with pytest.raises(LogError, match="needs two cameras") as error:
        started(plain_rig("cam", "lidar"), "stereo_pair=on")
    assert error.value.code == "CFG001"
    with pytest.raises(ConfigError, match=r"^stereo\.left=lfet: no such camera; did you mean 'left'\?$"):
        started(PAIR, "stereo.left=lfet")
    with pytest.raises(ConfigError, match="stereo_pair"):
        started(PAIR, "stereo_pair=maybe")


def test_a_pair_that_gives_no_depth_is_left_out_unless_asked_for():
    cameras = {name: replace(camera, size_wh=(24, 20)) for name, camera in PAIR.cameras.items()}
    small = Rig({**PAIR.mounts, "radar": Mount("radar", np.zeros(3), UPRIGHT)}, cameras)
    assert started(small).required_sensors() == ("radar",)
    with pytest.raises(LogError, match="images of less than 32 px a side"):
        started(small, "stereo_pair=on")
