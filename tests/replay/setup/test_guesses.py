"""What is guessed about the logs of ROS 2, and that replays work with it."""

import numpy as np
import pytest
from tests.replay.setup import drive as d

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.frame_buffer import SyncParams, choose_reference
from fbench.replay.logs.open import open_log
from fbench.replay.setup.configuration import load_config, setup_of


def reason(text, key):
    """The comment of the first line with a key."""
    return next(line.partition("#")[2] for line in text.splitlines() if line.startswith(f"{key} = "))


def table(text, name):
    """The text of one table."""
    return text.split(f"[{name}]")[1].split("\n\n")[0]


def test_all_sensors_of_a_vehicle(guess):
    config, text = guess(d.drive())
    kinds = {name: sensor.kind for name, sensor in config.sensors.items()}
    assert kinds == {
        **{f"camera_{name}": "camera" for name in d.CAMERAS}, "lidar_rear": "lidar", "lidar_top": "lidar",
        **{f"radar_{name}": "radar" for name in d.RADARS},
    }  # fmt: skip
    assert config.sensors["camera_left"].topic == "/sensing/camera/left/image_raw"
    assert config.sensors["camera_left"].calibration == "/sensing/camera/left/camera_info"
    assert config.body.frame == "base_link"
    assert config.body.pose == "/localization/odometry"
    assert config.truth.topics == ("/labels/objects",)
    assert config.classes == {"Car": "car", "CAR": "car", "ufo 7": "other"}
    assert "guess: 10 boxes, not a known name" in text
    # Cameras arrive 45 ms after the LiDAR; with a fifth more, in steps of 5 ms.
    assert (config.frames.timeout_ms, config.frames.tolerance_ms) == (55.0, 50.0)
    for left_out in (
        "/map/pointcloud",
        "image_raw/compressed",
        "image_rect",
        "concatenated",
        "/depth/image: image enc",
    ):
        assert left_out in text.split("# Not used.")[1]


def test_the_file_works_untouched(guess, tmp_path):
    _, text = guess(d.drive())
    (tmp_path / "fbench.toml").write_text(text)
    config = load_config(tmp_path / "fbench.toml")
    faults = FaultLog()
    reader = open_log(tmp_path / "log.mcap", faults, (), setup_of(config, tmp_path / "fbench.toml"))
    assert sorted(reader.rig.mounts) == sorted(config.sensors)
    assert len(reader.rig.cameras) == 4
    sync = SyncParams(config.frames.reference)
    assert choose_reference(reader.rig.kinds, reader.info, reader.num_messages, sync) == config.frames.reference
    assert len(list(reader.messages())) == 20 * 11 + 100
    assert len(list(reader.truths())) == 20
    assert not faults.num_lost


@pytest.mark.slow
def test_doppler_by_what_stands_still(guess):
    config, text = guess(d.drive())
    radars = {name: sensor for name, sensor in config.sensors.items() if sensor.kind == "radar"}
    assert [name for name, radar in radars.items() if radar.doppler == "approaching"] == ["radar_front_right"]
    assert [name for name, radar in radars.items() if radar.ego_motion == "removed"] == ["radar_rear_left"]
    assert "20 of 20 scans fit a vehicle at 9.0 m/s, poses say so" in reason(text, "doppler")


def test_without_poses_driving_forward_is_taken_for_granted(guess):
    config, text = guess(d.drive(odometry_too=False))
    assert config.sensors["radar_front"].doppler == "receding"
    assert config.sensors["radar_front_right"].doppler == "approaching"
    assert config.sensors["radar_rear_left"].ego_motion == "removed"
    assert "assuming that it drives forward" in reason(text, "doppler")


def test_poses_tell_reversing_from_the_other_sign(guess):
    config, _ = guess(d.drive(speed_mps=-4.0))
    assert config.sensors["radar_front"].doppler == "receding"
    assert config.sensors["radar_front_right"].doppler == "approaching"


def test_transforms_that_move_say_where_the_body_is(guess):
    drive = d.drive(odometry_too=False)
    for _, ns in d.steps(20, 100):
        drive.add("/tf", ns, d.transforms([("odom", "base_link", (1.0, 0, 0), (0, 0, 0, 1.0))], ns))
    config, text = guess(drive)
    assert config.body.pose == "/tf"
    assert "pose = \"/tf\"  # its transforms say where the body is in 'odom'" in text


@pytest.mark.parametrize("odometry_too", [True, False])
def test_a_vehicle_that_stands_says_nothing(guess, odometry_too):
    config, text = guess(d.drive(speed_mps=0.0, odometry_too=odometry_too))
    radar = config.sensors["radar_front_right"]
    assert (radar.doppler, radar.ego_motion) == ("receding", "included")
    assert "guess: the vehicle hardly moves in the sampled scans; check it" in table(text, "sensors.radar_front_right")


def lidar_log(**clouds):
    """One LiDAR at /lidar/points, and more clouds by topic in coordinate frames on the body."""
    log = d.Drive()
    topics = {"/lidar/points": "lidar", **clouds}
    frames = sorted({frame for frame in topics.values() if frame not in ("", "map", "base_link")})
    log.add("/tf_static", d.START_NS, d.transforms([("base_link", f, (0, 0, 1), (0, 0, 0, 1)) for f in frames]))
    for _, ns in d.steps(8, 100):
        for topic, frame in topics.items():
            log.add(topic, ns + d.MS, d.points(frame, ns))
    return log


@pytest.mark.parametrize(
    ("topic", "frame", "why"),
    [
        ("/lidar/points_downsampled", "lidar", "'downsampled'"),
        ("/obstacle_clusters", "base_link", "'obstacle'"),
        ("/no_ground/cloud", "base_link", "'ground'"),
        ("/slam/cloud", "map", "'map' is stationary"),
        ("/lidar/points_xyzi", "lidar", "the same device as /lidar/points"),
        ("/other/name", "lidar", "in the same coordinate frame as /lidar/points, 'lidar'"),
    ],
)
def test_clouds_that_are_no_sensor_of_their_own(guess, topic, frame, why):
    config, text = guess(lidar_log(**{topic: frame}))
    assert [s.topic for s in config.sensors.values()] == ["/lidar/points"]
    assert why in text.split(f"#   {topic}: ")[1].splitlines()[0]


def test_derived_clouds_are_taken_where_there_are_no_others(guess):
    log = d.Drive()
    for _, ns in d.steps(5, 100):
        log.add("/concatenated/pointcloud", ns, d.points("base_link", ns))
    config, _ = guess(log)
    assert [s.topic for s in config.sensors.values()] == ["/concatenated/pointcloud"]


def test_dense_clouds_with_doppler_are_those_of_a_lidar(guess):
    log = d.Drive()
    for _, ns in d.steps(4, 100):
        num = 4000
        ring, velocity = np.zeros(num, np.uint16), np.zeros(num, np.float32)
        log.add("/aeva/points", ns, d.points("base_link", ns, num, ring=ring, velocity=velocity))
    config, text = guess(log)
    assert config.sensors["aeva"].kind == "lidar"
    assert "FMCW; check it" in text


def test_compensated_velocities_are_not_read(guess):
    log = d.Drive()
    for _, ns in d.steps(4, 100):
        log.add("/radar/points", ns, d.radar_points("base_link", ns, 5.0, field_name="v_r_compensated"))
    config, text = guess(log)
    assert config.sensors["radar"].kind == "radar"
    assert "'v_r_compensated', which fbench doesn't read" in text


def test_a_radar_whose_doppler_is_called_otherwise_is_one_by_its_name(guess):
    """The fields are shown, since what it measures isn't read."""
    log = lidar_log()
    for _, ns in d.steps(10, 50):
        log.add("/radar/points", ns, d.radar_points("base_link", ns, 9.0, field_name="speed_q"))
    config, text = guess(log)
    assert {name: sensor.kind for name, sensor in config.sensors.items()} == {"lidar": "lidar", "radar": "radar"}
    assert "by its name, but none of its fields (x, y, z, speed_q, rcs) is a known radial velocity" in text


def test_sensors_without_calibration_are_commented_out(guess):
    log = lidar_log(**{"/back/points": "nowhere"})
    log.rows[:] = [
        (
            t,
            topic,
            kind,
            d.transforms([("base_link", "lidar", (0, 0, 1), (0, 0, 0, 1))]) if topic == "/tf_static" else m,
        )
        for t, topic, kind, m in log.rows
    ]
    for _, ns in d.steps(8, 100):
        log.add("/cam/image_raw", ns, d.raw_image("base_link", ns))
    config, text = guess(log)
    assert list(config.sensors) == ["cam", "lidar"]
    assert "# Left out: sensor 'lidar_back' has no transform to the body ('nowhere' to 'base_link'" in text
    assert "# Its images are used alone, by camera2d: camera 'cam' has no calibration" in text
    for _, ns in d.steps(8, 100):
        log.add("/front/image_raw", ns, d.raw_image("base_footprint", ns))
        log.add("/front/camera_info", ns, d.info("base_footprint", ns))
    log.add("/tf_static", d.START_NS, d.transforms([("base_link", "base_footprint", (0, 0, 0), (0, 0, 0, 1))]))
    config, text = guess(log)
    assert list(config.sensors) == ["camera_front", "lidar"]
    assert "# Left out: camera 'cam' has no calibration" in text
    assert '# [sensors.cam]\n# topic = "/cam/image_raw"' in text
    assert '# rig = ["rig.toml"]' in text


def test_body_that_is_not_called_so_is_the_root_below_the_world(guess):
    log = d.Drive()
    log.add("/tf_static", d.START_NS, d.transforms([("vehicle", "velodyne", (0, 0, 1), (0, 0, 0, 1))]))
    for i, ns in d.steps(6, 100):
        log.add("/tf", ns, d.transforms([("map", "vehicle", (i, 0, 0), (0, 0, 0, 1))], ns))
        log.add("/velodyne_points", ns + 1, d.points("velodyne", ns))
    config, text = guess(log)
    assert config.body.frame == "vehicle"
    assert "guess: root of the tree" in reason(text, "frame")


def test_a_log_without_transforms_can_be_replayed(guess, tmp_path):
    log = d.Drive()
    for _, ns in d.steps(6, 100):
        log.add("/velodyne_points", ns + 1, d.points("velodyne", ns))
    config, text = guess(log)
    (tmp_path / "fbench.toml").write_text(text)
    reader = open_log(tmp_path / "log.mcap", FaultLog(), (), setup_of(config, tmp_path / "fbench.toml"))
    assert config.body.frame == "velodyne"
    assert np.array_equal(reader.rig.body_T_sensor("velodyne"), np.eye(4))


def test_another_clock_gets_an_offset(guess):
    log = lidar_log(**{"/radar/points": "radar"})
    log.rows[:] = [
        (t, topic, kind, d.points("radar", t - 3_600_000 * d.MS) if topic == "/radar/points" else m)
        for t, topic, kind, m in log.rows
    ]
    config, text = guess(log)
    # Its stamps are an hour before the recording, those of the LiDAR 1 ms; names alone don't make a radar of it.
    assert config.sensors["radar" if "radar" in config.sensors else "lidar_radar"].offset_ms == 3_599_999.0
    assert "guess: it has another clock" in text


def test_zero_stamps_mean_times_of_recording(guess):
    log = d.Drive()
    for _, ns in d.steps(6, 100):
        log.add("/lidar/points", ns, d.points("base_link", 0))
    config, text = guess(log)
    assert config.frames.stamps == "log"
    assert "no message has a stamp" in reason(text, "stamps")


def test_rectified_images_with_distortion_are_a_guess(guess):
    log = d.Drive()
    for _, ns in d.steps(4, 100):
        log.add("/cam/image_rect", ns, d.raw_image("base_link", ns))
        log.add("/cam/camera_info", ns, d.info("base_link", ns, distortion=(0.1, 0, 0, 0, 0)))
    config, text = guess(log)
    assert config.sensors["cam"].topic == "/cam/image_rect"
    assert "guess: in the same namespace; but images are rectified" in reason(text, "calibration")


def test_a_camera_that_looks_up_is_a_guess(guess):
    log = d.Drive()
    edges = [("base_link", "housing", (0, 0, 1), (0, 0, 0, 1)), ("base_link", "optical", (0, 0, 1), d.OPTICAL)]
    log.add("/tf_static", d.START_NS, d.transforms(edges))
    for _, ns in d.steps(4, 100):
        for name in ("housing", "optical"):
            log.add(f"/cam_{name}/image_raw", ns, d.raw_image(name, ns))
            log.add(f"/cam_{name}/camera_info", ns, d.info(name, ns))
    config, text = guess(log)
    assert sorted(config.sensors) == ["cam_housing", "cam_optical"]
    assert "frame = " not in table(text, "sensors.cam_optical")
    assert 'frame = "housing"  # guess: its z axis points up or down' in table(text, "sensors.cam_housing")


def test_no_sensor_is_an_error(guess):
    log = d.Drive()
    log.add("/labels", d.START_NS, d.boxes(d.START_NS, ["car"]))
    with pytest.raises(LogError, match="holds no camera, LiDAR or radar that fbench can read"):
        guess(log)


def test_files_beside_the_log_are_suggested(guess, tmp_path):
    (tmp_path / "label_2").mkdir()
    for name in ("camchain-front.yaml", "car.urdf", "notes.txt", "ground-truth.csv"):
        (tmp_path / name).write_text("")
    config, text = guess(lidar_log())
    assert '# rig = ["camchain-front.yaml", "car.urdf"]' in text
    assert '# file = "ground-truth.csv"' in text
    assert '# file = "label_2"' in text
    assert "notes" not in text
    assert (config.truth.file, config.body.rig) == (None, ())


def test_only_cameras_have_intrinsics(guess):
    log = d.Drive()
    edges = [("base_link", "lidar", (0, 0, 1), (0, 0, 0, 1)), ("base_link", "optical", (0, 0, 1), d.OPTICAL)]
    log.add("/tf_static", d.START_NS, d.transforms(edges))
    for _, ns in d.steps(8, 100):
        log.add("/points", ns, d.points("lidar", ns))
        log.add("/image", ns, d.jpeg("optical", ns))
        log.add("/camera_info", ns, d.info("optical", ns))
    config, _ = guess(log)
    assert {name: sensor.calibration for name, sensor in config.sensors.items()} == {
        "camera": "/camera_info", "lidar": "",
    }  # fmt: skip
