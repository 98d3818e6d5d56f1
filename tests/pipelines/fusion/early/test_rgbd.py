"""Learned early fusion: what the network gets, what it does without, and that its boxes are fused as a camera's.

The network reports what it gets: each pixel of its input is a box, whose scores are the channels.
"""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import CAMERA, JPEG, MOUNTS, frame, image
from tests.pipelines.networks import encode_pixels
from tests.pipelines.scenes import car_back, road

from fbench.pipelines.fusion.early.cloud import DepthStage
from fbench.pipelines.fusion.early.rgbd import RGBD_WEIGHTS, RgbdStage, RgbdView, draw_window
from fbench.pipelines.sensors.camera.channels import ImagePoints
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetections, CameraDetector, CameraParams
from fbench.pipelines.sensors.camera.layouts import letterbox
from fbench.pipelines.sensors.radar.stage import RadarStage
from fbench.pipelines.variants.early import Early2D, Early2DParams, Early3D, Early3DParams
from fbench.replay.contracts.errors import ConfigError, LogError, ModelError
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.contracts.settings import apply_settings, describe_file
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.runs.digest import digest

LOG = LogInfo("drive", "id")
RIG = Rig(MOUNTS, {"cam": CAMERA})
POINT = [8.0, 0.124, -0.252]
"""At u = 21.75, v = 35.25 px; in an input of 60 x 70 px, where the image is 50 px high, in column 11 and row 27."""
CAR = car_back(10.0, 0.0).tolist()
GREY_POINT = 144 / 255  # At 500 px * 0.5 its depth is as 10.24 m at 320 px: 255 - 254 * log(10.24 / 1.5) / log(80)


@pytest.fixture(scope="module")
def pixels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("networks") / "pixels.onnx"
    path.write_bytes(encode_pixels((60, 70)))
    return path


def params(weights: Path, *settings: str) -> Early2DParams:
    own = [f"rgbd.weights={weights}", "rgbd.min_score=0.5", "rgbd.nms_iou=1", "rgbd.nms_containment=1"]
    return apply_settings(Early2DParams(), ["detector=rgbd", "fusion.camera_share=1", *own, *settings])


def pipeline(weights: Path, *settings: str, rig: Rig = RIG, log: LogInfo = LOG) -> Early2D:
    made = Early2D(params(weights, *settings))
    made.start(rig, log)
    return made


class Stages:
    """The network's stage with those that give it points."""

    def __init__(self, weights: Path, *settings: str, rig: Rig = RIG) -> None:
        own = params(weights, *settings)
        settings_ = SensorSettings(own, rig)
        self.network = RgbdStage(own.rgbd, own.fusion.camera_share)
        self.network.cameras.start(rig, LOG, settings_)
        self.network.start("early2d", rig, LOG)
        self._depth = DepthStage(rig, LOG, own.lidar, settings_, None)
        self._radar = RadarStage(rig, LOG, own.radar, settings_)

    def detect(self, at: Frame) -> RgbdView:
        """What one frame tells."""
        clock, faults = StageClock(), list[Fault]()
        images, depth = self.network.view(at, clock, faults), self._depth.view(at, clock, faults)
        return self.network.detect(images, depth, self._radar.echoes(at, clock), clock)

    def find(self, at: Frame) -> CameraDetections:
        """Boxes of the camera `cam`."""
        return self.network.conclude(self.detect(at), StageClock())["cam"]


def cloud(*points: list[float], ground: bool = True) -> PointCloud:
    xyz = np.array(points, np.float64).reshape(-1, 3)
    return PointCloud("lidar", 0, 0, np.concatenate([road(), xyz] if ground else [xyz]).astype(np.float32))


def centers(boxes: CameraDetections, label: str) -> list[tuple[float, float]]:
    own = boxes.xyxy_px[boxes.label == label]
    middle = (own[:, :2] + own[:, 2:]) / 2
    return sorted((round(float(u), 3), round(float(v), 3)) for u, v in middle)


def test_points_are_drawn_where_the_image_lies_in_the_input(pixels: Path):
    boxes = Stages(pixels).find(frame(0, image(), cloud(POINT)))
    # Column 11 and row 27 of the input, and those beside; 10 px of its height are border.
    around = sorted(
        (2 * (column + 0.5) - 0.5, 2 * (row + 0.5 - 10) - 0.5) for column in (10, 11, 12) for row in (26, 27, 28)
    )
    assert centers(boxes, "bus") == around
    assert boxes.label.tolist() == ["bus"] * 9, "which is the channel of depth"
    assert boxes.score == pytest.approx([GREY_POINT] * 9)
    assert boxes.min_score == 0.5


def test_colors_and_velocities_come_in_their_channels(pixels: Path):
    picture = np.zeros((100, 120, 3), np.uint8)
    for at, channel in enumerate((2, 1, 0)):  # red, green, blue of BGR
        picture[40:60, 40 * at : 40 * at + 40, channel] = 255
    boxes = Stages(pixels, "rgbd.min_score=0.8").find(frame(0, image(encode_jpeg(picture))))
    for at, label in enumerate(("car", "van", "truck")):
        u, v = np.array(centers(boxes, label)).T
        assert (abs(u.min() - 40 * at) < 4, abs(u.max() - 40 * at - 39) < 4) == (True, True)
        assert (abs(v.min() - 40) < 4, abs(v.max() - 59) < 4) == (True, True)
    away = RadarScan("radar", 0, 0, np.array([POINT], np.float32), np.array([12.0], np.float32))
    boxes = Stages(pixels, "radar.doppler.ego_motion=removed").find(frame(0, image(), away))
    assert set(boxes.label) == {"motorcycle"}, "which is the channel of radial velocity: 128 + 127 * 12 / 20"
    assert boxes.score == pytest.approx([204 / 255] * len(boxes))


def test_overlapping_boxes_of_the_network_become_one(tmp_path: Path):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=6.0))
    assert len(Stages(path, "rgbd.nms_iou=0.2").find(frame(0, image(), cloud(POINT)))) == 1


def test_boxes_for_others_to_confirm_have_lower_scores(pixels: Path):
    shown = frame(0, image(), cloud(POINT))
    assert len(Stages(pixels, "rgbd.min_score=0.7").find(shown)) == 0
    boxes = Stages(pixels, "rgbd.min_score=0.7", "fusion.camera_share=0.6").find(shown)
    assert boxes.score == pytest.approx([GREY_POINT] * 9)
    assert boxes.min_score == 0.7, "below which a camera alone reports nothing"


def test_without_points_it_sees_the_image_alone(pixels: Path):
    picture = np.full((100, 120, 3), 200, np.uint8)
    alone = Stages(pixels).find(frame(0, image(encode_jpeg(picture))))
    assert len(alone) > 900
    assert "bus" not in alone.label


@pytest.mark.parametrize("detector", ["rgb", "rgbd"])
@pytest.mark.parametrize("picture", [None, JPEG[:50]], ids=["missing", "corrupt"])
def test_without_the_image_it_goes_on_as_without_a_network(pixels: Path, detector: str, picture: bytes | None):
    shown = [] if picture is None else [image(picture)]
    drive = [frame(index, *shown, cloud(*CAR)) for index in range(2)]
    own = ["camera.weights=none"] if detector == "rgb" else []
    made = pipeline(pixels, f"detector={detector}", *own)
    for at in drive:
        output = made.step(at)
        assert [fault.code for fault in output.faults] == (["DEC002"] if shown and detector == "rgbd" else [])
        assert len(output.detections) == 1, "the car of points"
        assert output.detections.sources.tolist() == [int(Source.L)]
        assert "detect.network" not in output.stage_ns


def test_its_boxes_label_the_cloud(tmp_path: Path):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=12.0))
    output = pipeline(path, "rgbd.nms_iou=0.01").step(frame(0, image(), cloud(*CAR)))
    boxes = output.detections
    assert "bus" in boxes.label, "the channel of depth"
    both = boxes.sources == int(Source.C | Source.L)
    assert both.any()
    assert ((boxes.distance_m[both] > 10) & (boxes.distance_m[both] < 16)).all(), "its middle is behind its points"
    assert list(output.stage_ns)[-4:] == ["preprocess", "detect.network", "fuse", "track"]
    assert output.missing == {}


def test_early_fusion_in_space_uses_it_as_well(tmp_path: Path):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=12.0))
    own = apply_settings(Early3DParams(), ["detector=rgbd", f"rgbd.weights={path}", "rgbd.min_score=0.5"])
    made = Early3D(own)
    made.start(RIG, LOG)
    output = made.step(frame(0, image(), cloud(*CAR)))
    assert output.detections.sources.tolist() == [int(Source.C | Source.L)]
    assert output.detections.label.tolist() == ["bus"]


def test_the_ground_is_remembered_within_a_segment(pixels: Path):
    stages, bare = Stages(pixels), frame(1, image(), cloud(POINT, ground=False))
    assert len(stages.find(frame(0, image(), cloud()))) == 0
    assert len(stages.find(bare)) == 9, "1.3 m above the ground of the frame before"
    stages.network.reset()
    assert len(stages.find(bare)) == 0, "below the body's origin, where the ground is taken to be"


def test_frames_that_other_processes_observe_give_the_same(tmp_path: Path):
    path = tmp_path / "wide.onnx"
    path.write_bytes(encode_pixels((60, 70), side_px=12.0))
    drive = [frame(0, image(), cloud()), frame(1, image(), cloud(*CAR, ground=False)),
             frame(2, image(), cloud(*CAR)), frame(3, image(JPEG[:50]), cloud(*CAR, ground=False))]  # fmt: skip
    alone, joint, others = pipeline(path), pipeline(path), [pipeline(path) for _ in range(2)]
    sizes = []
    for index, one in enumerate(drive):
        observed = others[index % 2].observe(one)
        others[1 - index % 2].pass_by(one)
        joint.pass_by(one)
        seen, clock = pickle.loads(pickle.dumps(observed))  # noqa: S301 - our own
        assert isinstance(clock, StageClock)
        expected, output = alone.step(one), joint.conclude(one, (seen, clock))
        assert digest([output.detections, output.tracks]) == digest([expected.detections, expected.tracks])
        assert output.faults == expected.faults
        sizes.append(len(output.detections))
    assert max(sizes) > 0


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
    with pytest.raises(ConfigError, match="early3d with detector=rgbd needs a network for this log"):
        Early3D(Early3DParams(detector="rgbd")).start(RIG, LOG)
    with pytest.raises(LogError, match=r"early3d with detector=rgbd needs a camera; the log has: lidar lidar$"):
        Early3D(Early3DParams(detector="rgbd")).start(RIG.without({"cam", "radar"}), LOG)
    city = Early2D(Early2DParams(detector="rgbd"))
    city.start(RIG, LogInfo("city", "id", {SIMULATED: "1"}))
    assert dict(city.identity()) == {"rgbd.weights": describe_file(RGBD_WEIGHTS)}
    assert RGBD_WEIGHTS.stat().st_size <= 4_000_000
    assert pipeline(pixels, log=LogInfo("city", "id", {SIMULATED: "1"})).identity() == {}, "a parameter names it"
    assert Early2D().identity() == {}


def test_cameras_differ_in_what_is_set_for_them(pixels: Path):
    both = Rig({**MOUNTS, "rear": MOUNTS["cam"]}, {"cam": CAMERA, "rear": CAMERA})
    shown = frame(0, image(), Image("rear", 0, 0, JPEG, "jpeg", (120, 100)), cloud(POINT))
    stages = Stages(pixels, "rear.min_score=0.9", rig=both)
    found = stages.network.conclude(stages.detect(shown), StageClock())
    assert {name: len(boxes) for name, boxes in found.items()} == {"cam": 9, "rear": 0}
    off = pipeline(pixels, "rear.weights=none", rig=both)
    output = off.step(shown)
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
        ("lidar.detector=learned", "lidar.detector=learned: early fusion detects in one cloud"),
        ("rgbd.min_score=2", r"rgbd\.min_score: expected between 0 and 1, got 2"),
        ("rgbd.input_wh=4,4", r"rgbd\.input_wh: expected between 32 and 8192, got 4"),
        ("detector=cloud", "detector=cloud: expected"),
    ],
)
def test_settings_that_make_no_sense(pixels: Path, setting: str, match: str):
    with pytest.raises(ConfigError, match=match):
        pipeline(pixels, setting)


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (("cam",), "early2d needs a LiDAR, a radar or a stereo pair of cameras; the log has: camera cam"),
        (("lidar",), "early2d works in images, and the rig has no camera"),
    ],
)
def test_rigs_that_lack_a_sensor(pixels: Path, names: tuple[str, ...], match: str):
    with pytest.raises(LogError, match=match):
        pipeline(pixels, rig=Rig({name: MOUNTS[name] for name in names}, {"cam": CAMERA} if "cam" in names else {}))
