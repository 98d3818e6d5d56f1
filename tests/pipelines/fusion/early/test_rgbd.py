"""Learned early fusion in images: what the network gets, what it does without, and what is measured in its boxes.

The network reports what it gets: each pixel of its input is a box, whose scores are the channels.
"""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import CAMERA, JPEG, MOUNTS, frame, image
from tests.pipelines.networks import encode_pixels
from tests.pipelines.scenes import road

from fbench.pipelines.fusion.early.rgbd import RGBD_WEIGHTS, Measure, draw_window
from fbench.pipelines.sensors.camera.channels import ImagePoints
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetector, CameraParams
from fbench.pipelines.sensors.camera.layouts import letterbox
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.pipelines.variants.early_late import Early2D, Early2DParams
from fbench.replay.contracts.errors import ConfigError, LogError, ModelError
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.settings import apply_settings, describe_file
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.runs.digest import digest

LOG = LogInfo("drive", "id")
RIG = Rig(MOUNTS, {"cam": CAMERA})
POINT = [8.0, 0.124, -0.252]
"""At u = 21.75, v = 35.25 px; in an input of 60 x 70 px, where the image is 50 px high, in column 11 and row 27."""
GREY_POINT = 144 / 255  # At 500 px * 0.5 its depth is as 10.24 m at 320 px: 255 - 254 * log(10.24 / 1.5) / log(80)


@pytest.fixture(scope="module")
def pixels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("networks") / "pixels.onnx"
    path.write_bytes(encode_pixels((60, 70)))
    return path


def pipeline(weights: Path, *settings: str, rig: Rig = RIG, log: LogInfo = LOG) -> Early2D:
    own = [f"rgbd.weights={weights}", "rgbd.min_score=0.5", "rgbd.nms_iou=1", "rgbd.nms_containment=1"]
    made = Early2D(apply_settings(Early2DParams(), ["detector=rgbd", *own, *settings]))
    made.start(rig, log)
    return made


def cloud(*points: list[float], ground: bool = True) -> PointCloud:
    xyz = np.array(points, np.float64).reshape(-1, 3)
    return PointCloud("lidar", 0, 0, np.concatenate([road(), xyz] if ground else [xyz]).astype(np.float32))


def found(made: Early2D, at: Frame) -> Boxes2D:
    boxes = made.step(at).detections
    assert isinstance(boxes, Boxes2D)
    return boxes


def centers(boxes: Boxes2D) -> list[tuple[float, float]]:
    middle = (boxes.xyxy_px[:, :2] + boxes.xyxy_px[:, 2:]) / 2
    return sorted((round(float(u), 3), round(float(v), 3)) for u, v in middle)


def test_points_are_drawn_where_the_image_lies_in_the_input(pixels: Path):
    boxes = found(pipeline(pixels), frame(0, image(), cloud(POINT)))
    # Column 11 and row 27 of the input, and those beside; 10 px of its height are border.
    around = sorted(
        (2 * (column + 0.5) - 0.5, 2 * (row + 0.5 - 10) - 0.5) for column in (10, 11, 12) for row in (26, 27, 28)
    )
    assert centers(boxes) == around
    assert boxes.label.tolist() == ["bus"] * 9, "which is the channel of depth"
    assert boxes.score == pytest.approx([GREY_POINT] * 9)
    assert boxes.camera.tolist() == ["cam"] * 9


def test_colors_and_velocities_come_in_their_channels(pixels: Path):
    picture = np.zeros((100, 120, 3), np.uint8)
    for at, channel in enumerate((2, 1, 0)):  # red, green, blue of BGR
        picture[40:60, 40 * at : 40 * at + 40, channel] = 255
    boxes = found(pipeline(pixels, "rgbd.min_score=0.8"), frame(0, image(encode_jpeg(picture))))
    for at, label in enumerate(("car", "van", "truck")):
        u, v = np.array(centers(boxes[boxes.label == label])).T
        assert (abs(u.min() - 40 * at) < 4, abs(u.max() - 40 * at - 39) < 4) == (True, True)
        assert (abs(v.min() - 40) < 4, abs(v.max() - 59) < 4) == (True, True)
    away = RadarScan("radar", 0, 0, np.array([POINT], np.float32), np.array([12.0], np.float32))
    still = pipeline(pixels, "radar.doppler.ego_motion=removed")
    boxes = found(still, frame(0, image(), away))
    assert set(boxes.label) == {"motorcycle"}, "which is the channel of radial velocity: 128 + 127 * 12 / 20"
    assert boxes.score == pytest.approx([204 / 255] * len(boxes))


def test_overlapping_boxes_of_the_network_become_one(tmp_path: Path):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=6.0))
    boxes = found(pipeline(path, "rgbd.nms_iou=0.2"), frame(0, image(), cloud(POINT)))
    assert len(boxes) == 1


def test_without_points_it_sees_the_image_alone(pixels: Path):
    picture = np.full((100, 120, 3), 200, np.uint8)
    alone = found(pipeline(pixels), frame(0, image(encode_jpeg(picture))))
    assert len(alone) > 900
    assert set(alone.sources.tolist()) == {1}
    assert np.isnan(alone.range_rate_mps).all()


@pytest.mark.parametrize("picture", [None, JPEG[:50]], ids=["missing", "corrupt"])
def test_without_the_image_it_sees_points_before_grey(tmp_path: Path, picture: bytes | None):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=40.0))  # cut by the image's border, so that no size guesses depth
    made = pipeline(path, "rgbd.nms_iou=0.3", "rgbd.min_score=0.44")
    shown = [] if picture is None else [image(picture)]
    output = made.step(frame(0, *shown, cloud(POINT)))
    assert [fault.code for fault in output.faults] == ["DEC002"] * len(shown)
    boxes = output.detections
    assert boxes.score[0] == pytest.approx(GREY_POINT)
    assert boxes.sources.tolist() == [2], "grey shows boxes elsewhere, too, but nothing was measured in them"
    assert boxes.distance_m[0] == pytest.approx(8 + (12.0 + 2.6) / 4, abs=0.1), "a bus on average over headings"
    nothing = made.step(frame(1))
    assert len(nothing.detections) == 0
    assert "detect.network" not in nothing.stage_ns
    assert nothing.detections.arrays().keys() == boxes.arrays().keys()


def test_stages(pixels: Path):
    output = pipeline(pixels).step(frame(0, image(), cloud(POINT)))
    assert list(output.stage_ns) == ["decode", "calibrate", "preprocess", "detect.network", "fuse", "track"]
    assert output.missing == {}


def test_the_ground_is_remembered_within_a_segment(pixels: Path):
    made, bare = pipeline(pixels), frame(1, image(), cloud(POINT, ground=False))
    assert len(found(made, frame(0, image(), cloud()))) == 0
    assert len(found(made, bare)) == 9, "1.3 m above the ground of the frame before"
    made.reset("segment 1 begins")
    assert len(found(made, bare)) == 0, "below the body's origin, where the ground is taken to be"


def test_frames_that_other_processes_observe_give_the_same(pixels: Path):
    drive = [frame(0, image(), cloud()), frame(1, image(), cloud(POINT, ground=False)), frame(2, image(), cloud(POINT)),
             frame(3, image(JPEG[:50]), cloud(POINT, ground=False))]  # fmt: skip
    alone, joint, others = pipeline(pixels), pipeline(pixels), [pipeline(pixels) for _ in range(2)]
    for index, one in enumerate(drive):
        observed = others[index % 2].observe(one)
        others[1 - index % 2].pass_by(one)
        joint.pass_by(one)
        seen, clock = pickle.loads(pickle.dumps(observed))  # noqa: S301 - our own
        assert isinstance(clock, StageClock)
        expected, output = alone.step(one), joint.conclude(one, (seen, clock))
        assert digest([output.detections, output.tracks]) == digest([expected.detections, expected.tracks])
        assert output.faults == expected.faults


def test_windows_of_wide_images_get_their_part_of_the_points():
    points = ImagePoints(np.array([[105.0, 11.0, 12.0]], np.float32), np.zeros((0, 4), np.float32), 320.0)
    drawn = draw_window(points, (80, 0, 120, 20), letterbox((40, 20), (80, 80), centered=True), (80, 80))
    rows, columns = np.nonzero(drawn[..., 0])
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (49, 51, 41, 43), "(105 - 80) * 2, 11 * 2 + 20"
    top = draw_window(replace(points, lidar=np.array([[85.0, 0.2, 12.0]], np.float32)), (80, 0, 120, 20),
                      letterbox((40, 20), (80, 80), centered=True), (80, 80))  # fmt: skip
    assert np.nonzero(top[..., 0])[0].min() == 20, "nothing in the border"


def test_weights_of_simulated_logs(pixels: Path):
    with pytest.raises(
        ConfigError, match=r"early2d with detector=rgbd needs a network for this log: --set rgbd\.weights"
    ):
        Early2D(Early2DParams(detector="rgbd")).start(RIG, LOG)
    city = Early2D(Early2DParams(detector="rgbd"))
    city.start(RIG, LogInfo("city", "id", {SIMULATED: "1"}))
    assert dict(city.identity()) == {"rgbd.weights": describe_file(RGBD_WEIGHTS)}
    assert RGBD_WEIGHTS.stat().st_size <= 4_000_000
    assert pipeline(pixels, log=LogInfo("city", "id", {SIMULATED: "1"})).identity() == {}, "a parameter names it"
    assert Early2D().identity() == {}


def test_cameras_differ_in_what_is_set_for_them(pixels: Path):
    both = Rig({**MOUNTS, "rear": MOUNTS["cam"]}, {"cam": CAMERA, "rear": CAMERA})
    shown = frame(0, image(), Image("rear", 0, 0, JPEG, "jpeg", (120, 100)), cloud(POINT))
    assert set(found(pipeline(pixels, rig=both), shown).camera) == {"cam", "rear"}
    assert set(found(pipeline(pixels, "rear.min_score=0.9", rig=both), shown).camera) == {"cam"}
    off = pipeline(pixels, "rear.weights=none", rig=both)
    output = off.step(shown)
    assert set(output.detections.camera) == {"cam"}
    assert output.missing == {"rear": "no weights"}
    assert off.required_sensors() == ("cam", "lidar", "radar")


def test_networks_of_the_other_kind_are_refused(tmp_path: Path, pixels: Path):
    with pytest.raises(
        ModelError, match=r"city\.onnx: expected .*\(B, 5, H, W\).*looks at images alone: name it as camera"
    ):
        pipeline(CITY_WEIGHTS)
    with pytest.raises(ModelError, match=r"pixels\.onnx: expected .*\(B, 3, H, W\).*at points, too: name it as rgbd"):
        CameraDetector(CameraParams(weights=pixels))
    four = tmp_path / "four.onnx"
    four.write_bytes(encode_pixels((60, 70), channels=4))
    with pytest.raises(
        ModelError, match=r"four\.onnx: expected .*\(B, 5, H, W\): inputs images \(1, 4, 70, 60\)"
    ) as error:
        pipeline(four)
    assert "name it" not in str(error.value)
    with pytest.raises(ConfigError, match=r"none\.onnx: weights can't be read"):
        pipeline(tmp_path / "none.onnx")


@pytest.mark.parametrize(
    ("setting", "match"),
    [
        ("camera.weights=none", r"camera\.weights: detector=rgbd has a network of its own, set rgbd\.weights"),
        ("lidar.detector=learned", "lidar.detector=learned: detector=rgbd detects in images"),
        ("stereo_pair=on", "stereo_pair=on: detector=rgbd knows depth by LiDAR and radar only"),
        ("rgbd.min_score=2", r"rgbd\.min_score: expected between 0 and 1, got 2"),
        ("rgbd.input_wh=4,4", r"rgbd\.input_wh: expected between 32 and 8192, got 4"),
        ("detector=rgb", "detector=rgb: expected"),
    ],
)
def test_settings_that_make_no_sense(pixels: Path, setting: str, match: str):
    with pytest.raises(ConfigError, match=match):
        pipeline(pixels, setting)


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (("cam",), "early2d needs a LiDAR or a radar; the log has: camera cam"),
        (("lidar",), "early2d works in images, and the rig has no camera"),
    ],
)
def test_rigs_that_lack_a_sensor(pixels: Path, names: tuple[str, ...], match: str):
    with pytest.raises(LogError, match=match):
        pipeline(pixels, rig=Rig({name: MOUNTS[name] for name in names}, {"cam": CAMERA} if "cam" in names else {}))


# Measuring: the camera looks along x from the body's origin; the box's middle is its principal point.

BOX = np.array([9.5, 4.5, 49.5, 34.5])
MIDDLE = [29.5, 19.5]
HALF_M = (4.2 + 1.8) / 4  # From the near side of a car to its middle


def measure(lidar_m=(), echo_m=(), rate_mps=None, own_mps=8.0) -> Measure:
    """Points in the middle of the box at these depths."""
    num = len(echo_m)
    rate = np.zeros(num) if rate_mps is None else np.array(rate_mps, np.float64)
    scan = Compensated(
        np.zeros((num, 3)), np.zeros((num, 3)), rate, np.zeros(num), np.ones(num, bool), np.full(num, own_mps)
    )
    place = np.array([MIDDLE])
    return Measure(RIG, "cam", np.repeat(place, len(lidar_m), 0), np.array(lidar_m, np.float64),
                   np.repeat(place, num, 0), np.array(echo_m, np.float64), scan, 0.3)  # fmt: skip


def test_lidar_tells_the_depth_of_the_near_side():
    # A car at 20 m, what is seen through its windows, and a pole before it.
    found = measure([5.0, 5.0, 5.0, 20.0, 20.1, 20.2, 21.0, 22.0, 60.0]).find(BOX, "car", 18.0, 1)
    assert found.distance_m == pytest.approx(20.1 + HALF_M), "a quarter of those that fit the box's height is nearer"
    assert (found.sources, np.isnan(found.rate_mps)) == (3, True)
    cut = measure([20.0, 20.5, 60.0]).find(BOX, "car", float("nan"), 1)
    assert cut.distance_m == pytest.approx(20.0 + HALF_M)


def test_points_at_the_edge_of_a_box_may_be_of_something_else():
    edge = measure([20.0] * 4)
    edge.lidar_px[:, 0] = 16.0
    assert edge.find(BOX, "car", 30.0, 1).distance_m == pytest.approx(30.0 + HALF_M)


def test_without_lidar_echoes_tell_it_else_the_height_of_the_box():
    found = measure([], [19.0, 20.0, 60.0], [3.0, 3.2, 9.0]).find(BOX, "car", 18.0, 1)
    assert found.distance_m == pytest.approx(19.0 + HALF_M)
    assert found.rate_mps == pytest.approx(3.1 - 8.0)
    assert found.sources == 5
    guessed = measure([60.0], [60.0], [3.0]).find(BOX, "car", 18.0, 1)
    assert guessed.distance_m == pytest.approx(18.0 + HALF_M)
    assert (guessed.sources, np.isnan(guessed.rate_mps)) == (1, True)
    unknown = measure().find(BOX, "car", float("nan"), 1)
    assert np.isnan(unknown.distance_m)


def test_echoes_at_the_depth_tell_the_range_rate():
    # Two move with it, one stands on the road there, and one is far behind.
    found = measure([20.0] * 4, [20.0, 21.0, 22.0, 40.0], [3.0, 3.4, 0.0, -9.0]).find(BOX, "car", 20.0, 1)
    assert found.rate_mps == pytest.approx(3.2 - 8.0)
    standing = measure([20.0] * 4, [20.0, 21.0], [0.1, -0.1]).find(BOX, "car", 20.0, 1)
    assert standing.rate_mps == pytest.approx(-8.0)
    unmeasured = measure([20.0] * 4, [20.0], [np.nan]).find(BOX, "car", 20.0, 1)
    assert (unmeasured.sources, np.isnan(unmeasured.rate_mps)) == (7, True)
