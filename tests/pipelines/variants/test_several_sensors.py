"""Several sensors of one kind: merged by all pipelines, each with its own parameters where that makes sense."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import AHEAD, CAMERA, UPRIGHT, assert_equal, cloud, frame, image, scan
from tests.pipelines.scenes import echoes, surroundings

from fbench.pipelines.variants.camera2d import Camera2D, Camera2DParams
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.pipelines.variants.lidar import Lidar3D, Lidar3DParams
from fbench.pipelines.variants.radar import Radar3D, Radar3DParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.transforms import inverse, pose_matrix, transform

LOG = LogInfo("drive", "id")
TURNED = np.array([0, 0, 1.0, 0])  # half a turn about z
QUARTER = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def rig(**mounts: Mount) -> Rig:
    return Rig(mounts, {name: CAMERA for name, mount in mounts.items() if mount.kind == "camera"})


def mount(kind, x=0.0, y=0.0, z=0.0, rotation=UPRIGHT):
    return Mount(kind, np.array([x, y, z]), rotation)


def detected(pipeline, sensors: Rig, *messages) -> Boxes3D:
    pipeline.start(sensors, LOG)
    found = pipeline.step(frame(0, *messages)).detections
    assert isinstance(found, Boxes3D)
    return found


def seen_from(sensors: Rig, name: str, xyz):
    """Points in body coordinates as a sensor gives them."""
    return transform(inverse(sensors.body_T_sensor(name)), xyz).astype(np.float32)


def with_settings(cls, params, *settings):
    return cls(apply_settings(params, settings))


# LiDAR

TWO_LIDARS = rig(left=mount("lidar", 0, 2.0), right=mount("lidar", 0, -2.0, rotation=TURNED))
"""Their middle is where the one LiDAR is."""


def split_cloud(sensors=TWO_LIDARS):
    xyz = cloud().xyz.astype(np.float64)
    is_left = np.arange(len(xyz)) % 3 > 0
    return [
        PointCloud(name, 0, 0, seen_from(sensors, name, xyz[rows]))
        for name, rows in (("left", is_left), ("right", ~is_left))
    ]


@pytest.mark.parametrize("make", [Lidar3D, Late3D])
def test_a_cloud_split_over_two_lidars_gives_the_same(make):
    one = detected(make(), rig(lidar=mount("lidar")), cloud())
    two = detected(make(), TWO_LIDARS, *split_cloud())
    assert len(one) == 1
    assert two.center_m == pytest.approx(one.center_m, abs=1e-4)
    assert two.score == pytest.approx(one.score, abs=1e-3)
    assert_equal(two, detected(make(), TWO_LIDARS, *split_cloud()[::-1]))


def test_one_of_two_lidars_goes_on_alone():
    left, _ = split_cloud()
    assert len(detected(Lidar3D(), TWO_LIDARS, left)) == 1


def test_ranges_by_lidar():
    def num(*settings):
        return len(detected(with_settings(Lidar3D, Lidar3DParams(), *settings), TWO_LIDARS, *split_cloud()))

    assert num() == num("left.min_range_m=1", "right.max_range_m=50") == 1
    assert num("left.min_range_m=30") == num("left.max_range_m=15") == 1  # a third of the points is enough
    assert num("left.min_range_m=30", "right.max_range_m=15") == 0
    assert num("lidar.max_range_m=15") == num("lidar.min_range_m=30") == 0
    assert num("lidar.max_range_m=15", "left.max_range_m=none") == 1


# Radar

THREE_RADARS = rig(
    front=mount("radar"), left=mount("radar", 0, 0, rotation=QUARTER), right=mount("radar", 0, 0, rotation=TURNED)
)


def split_scan():
    """One scan, split by azimuth between three radars at one place that point to other sides."""
    xyz = scan().xyz.astype(np.float64)
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    parts = {"front": np.abs(azimuth) < 0.3, "left": azimuth >= 0.3, "right": azimuth <= -0.3}
    velocity = scan().radial_velocity_mps
    return [
        RadarScan(
            name, 0, 0, seen_from(THREE_RADARS, name, xyz[rows]), velocity[rows], np.full(rows.sum(), 60, np.float32)
        )
        for name, rows in parts.items()
    ]


@pytest.mark.parametrize("make", [Radar3D, Late3D])
def test_a_scan_split_over_three_radars_gives_the_same(make):
    """Each finds the same ego motion in its part, so that their echoes fit together over ground."""
    one = detected(make(), rig(radar=mount("radar")), scan())
    three = detected(make(), THREE_RADARS, *split_scan())
    assert len(one) == 1
    assert three.center_m == pytest.approx(one.center_m, abs=1e-3)
    assert three.velocity_mps == pytest.approx(one.velocity_mps, abs=0.05)
    assert_equal(three, detected(make(), THREE_RADARS, *split_scan()[::-1]))


def test_each_radar_moves_in_its_own_way():
    """On a turning vehicle a radar ahead of the axle moves sideways, one behind it to the other side."""
    speed, turn = 8.0, 0.4
    sensors = rig(front=mount("radar", 3.5), rear=mount("radar", -1.0, rotation=TURNED))
    messages = []
    for name in ("front", "rear"):
        body_T_sensor = sensors.body_T_sensor(name)
        ahead = np.concatenate([echoes(20.0, 0.0), surroundings()])
        xyz = transform(pose_matrix(body_T_sensor[:3, 3], UPRIGHT), ahead if name == "front" else -surroundings())
        velocity = np.array([speed, turn * body_T_sensor[0, 3]])
        direction = xyz - body_T_sensor[:3, 3]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        over_ground = np.where(np.arange(len(xyz)) < 40, 3.0, 0.0) if name == "front" else 0.0
        measured = over_ground - direction[:, :2] @ velocity
        messages.append(RadarScan(name, 0, 0, seen_from(sensors, name, xyz), measured.astype(np.float32)))
    found = detected(Radar3D(), sensors, *messages)
    assert len(found) == 1
    assert found.velocity_mps[0] == pytest.approx([3.0, 0, 0], abs=0.15)
    assert found.center_m[0, 0] == pytest.approx(3.5 + 21.7, abs=0.5)


def test_parameters_by_radar():
    def speeds(*settings):
        pipeline = with_settings(Radar3D, Radar3DParams(), *settings)
        return detected(pipeline, THREE_RADARS, *split_scan()).velocity_mps[:, 0].round(1).tolist()

    assert speeds() == speeds("left.max_range_m=10", "right.min_magnitude_db=70") == [3.0]
    assert speeds("front.max_range_m=10") == speeds("front.min_magnitude_db=70") == []
    assert speeds("radar.max_range_m=10", "front.max_range_m=60") == [3.0]
    assert speeds("front.doppler.period_mps=4") == pytest.approx([-1.0], abs=0.15)
    assert speeds("left.doppler.period_mps=4") == [3.0]


# Cameras

TWO_CAMERAS = rig(front=mount("camera", rotation=AHEAD), rear=mount("camera", rotation=AHEAD))


def images():
    return [replace(image(), sensor=name) for name in ("front", "rear")]


def test_parameters_by_camera(one_car: Path):
    def cameras(*settings):
        pipeline = with_settings(Camera2D, Camera2DParams(), f"camera.weights={one_car}", *settings)
        pipeline.start(TWO_CAMERAS, LOG)
        found = pipeline.step(frame(0, *images())).detections
        assert isinstance(found, Boxes2D)
        return list(zip(found.camera.tolist(), found.label.tolist(), strict=True))

    both = [("front", "car"), ("front", "pedestrian"), ("rear", "car"), ("rear", "pedestrian")]
    assert cameras() == both
    assert cameras("rear.min_score=0.85") == both[:3]
    assert cameras("camera.min_score=0.95", "rear.min_score=0.85") == both[2:3]


def test_weights_of_one_camera_alone(one_car: Path):
    pipeline = with_settings(Camera2D, Camera2DParams(), f"front.weights={one_car}")
    pipeline.start(TWO_CAMERAS, LOG)
    output = pipeline.step(frame(0, *images()))
    assert set(output.detections.camera.tolist()) == {"front"}
    assert output.missing == {"rear": "no weights"}
    with pytest.raises(ConfigError, match="camera2d needs a detector"):
        Camera2D(Camera2DParams()).start(TWO_CAMERAS, LOG)


def test_none_is_a_word_also_where_other_weights_must_be_files():
    assert pipeline_parameters("late3d", ["rear.weights=none"])["rear.weights"] == "none"


def test_none_turns_cameras_off_on_simulated_logs():
    simulated = LogInfo("city", "id", {"simulated": "2"})
    sensors = Rig({**TWO_LIDARS.mounts, **TWO_CAMERAS.mounts}, TWO_CAMERAS.cameras)
    off, blind = {"front": "no weights"}, {"front": "no weights", "rear": "no weights"}
    cases = [
        ((), {}),
        (("front.weights=none",), off),
        (("camera.weights=none",), blind),
        (("camera.weights=none", "rear.weights=auto"), off),
    ]
    for settings, missing in cases:
        pipeline = with_settings(Late3D, Late3DParams(), *settings)
        pipeline.start(sensors, simulated)
        assert pipeline.step(frame(0, *images(), *split_cloud())).missing == missing, settings


def test_late_fusion_of_several_of_each(one_car: Path):
    sensors = Rig({**TWO_LIDARS.mounts, "radar": mount("radar"), **TWO_CAMERAS.mounts}, TWO_CAMERAS.cameras)
    messages = [*images(), *split_cloud(), scan()]
    pipeline = with_settings(
        Late3D, Late3DParams(), f"front.weights={one_car}", "left.min_range_m=1", "radar.max_range_m=55"
    )
    pipeline.start(sensors, LOG)
    output = pipeline.step(frame(0, *messages))
    assert output.missing == {"rear": "no weights"}
    cars = output.detections[output.detections.label == "car"]
    assert cars.sources.tolist() == [7]
    assert cars.center_m == pytest.approx(np.array([[22.1, 0, -0.8]]), abs=0.15)


def test_a_camera_with_lens_distortion_is_fused(one_car: Path):
    bent = CameraModel(CAMERA.K, CAMERA.size_wh, "plumb_bob", np.array([-0.2, 0.02, 0, 0, 0]))
    sensors = Rig({"cam": mount("camera", rotation=AHEAD), "lidar": mount("lidar")}, {"cam": bent})
    pipeline = with_settings(Late3D, Late3DParams(), f"camera.weights={one_car}")
    found = detected(pipeline, sensors, image(), cloud())
    car = found[found.label == "car"]
    assert car.sources.tolist() == [3]
    assert car.center_m[0, :2] == pytest.approx([22.1, 0], abs=0.1)


# Errors


@pytest.mark.parametrize(
    ("make", "params", "setting", "message"),
    [
        (Lidar3D, Lidar3DParams(), "left.cluster.eps_m=1", "it is common to all LiDARs, set lidar.cluster.eps_m"),
        (Lidar3D, Lidar3DParams(), "left.ego_side_m=1", "it is common to all LiDARs, set lidar.ego_side_m"),
        (Lidar3D, Lidar3DParams(), "lft.min_range_m=1", "did you mean 'left.min_range_m'?"),
        (Lidar3D, Lidar3DParams(), "left.min_rnge_m=1", "did you mean 'left.min_range_m'?"),
        (Lidar3D, Lidar3DParams(), "left.min_range_m=-1", "lidar.min_range_m: expected between 0 and 1000, got -1"),
        (Lidar3D, Lidar3DParams(), "left.max_range_m=0", "lidar.max_range_m: expected between 0.1 and 10000, got 0"),
        (Lidar3D, Lidar3DParams(), "radar.max_range_m=1", "'radar' is a radar, and the pipeline has no use for it"),
        (Radar3D, Radar3DParams(), "radar.front.cluster.eps_m=1", "unknown parameter"),
        (Late3D, Late3DParams(), "left.tracking.max_missed=1", "unknown parameter 'left.tracking.max_missed'"),
        (Late3D, Late3DParams(), "front.weights=absent.onnx", "absent.onnx"),
    ],
)
def test_settings_by_sensor_that_make_no_sense(make, params, setting, message):
    sensors = Rig({**TWO_LIDARS.mounts, "radar": mount("radar"), **TWO_CAMERAS.mounts}, TWO_CAMERAS.cameras)
    with pytest.raises(ConfigError) as error:
        with_settings(make, params, setting).start(sensors, LOG)
    assert message in str(error.value)


def test_empty_frames_of_several_sensors():
    pipeline = Late3D()
    pipeline.start(Rig({**TWO_LIDARS.mounts, **THREE_RADARS.mounts}, {}), LOG)
    assert len(pipeline.step(Frame(0, 0, 0, {})).detections) == 0
