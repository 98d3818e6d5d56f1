"""Calibration of ROS logs, replaced and completed from elsewhere."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from tests.city_log import write_city_log

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig, RigChange
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.coordinate_frames import Edge
from fbench.replay.logs.open import open_log
from fbench.replay.logs.rig_patch import RigPatch
from fbench.replay.logs.setup import BoxSource, SensorSetup, Setup

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "ros2_log.py"
UPRIGHT = np.array([0.0, 0, 0, 1])
TOPIC = "/sensing/lidar/top/pointcloud"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A log of fbench, and the same as a ROS 2 recorder would have written it."""
    folder = tmp_path_factory.mktemp("ros")
    write_city_log(folder / "city.mcap", seconds=1.0)
    runpy.run_path(str(EXAMPLE))["rewrite"](folder / "city.mcap", folder / "drive.mcap")
    return folder / "city.mcap", folder / "drive.mcap"


def opened(log, **setup):
    return open_log(log, FaultLog(), (), Setup(**setup))


def test_the_example_keeps_points_mounts_and_truth(logs):
    own, ros = (open_log(log, FaultLog()) for log in logs)
    for kind in ("lidar", "radar"):
        old, new = own.rig.sensors(kind)[0], ros.rig.sensors(kind)[0]
        np.testing.assert_allclose(ros.rig.body_T_sensor(new), own.rig.body_T_sensor(old), atol=1e-12)
    for a, b in zip(own.truths(), ros.truths(), strict=True):
        assert (a.stamp_ns, a.log_ns) == (b.stamp_ns, b.log_ns)
        np.testing.assert_allclose(a.boxes3d.center_m, b.boxes3d.center_m)
        np.testing.assert_array_equal(a.boxes3d.track_id, b.boxes3d.track_id)
    lidar = [[m.xyz for m in reader.messages() if m.sensor in reader.rig.sensors("lidar")] for reader in (own, ros)]
    np.testing.assert_array_equal(np.concatenate(lidar[0]), np.concatenate(lidar[1]))


def test_an_edge_by_the_name_of_a_coordinate_frame_replaces_the_logs(logs):
    patch = RigPatch({"lidar_top_link": Edge("base_link", np.array([0.0, 0, 9]), UPRIGHT)})
    assert opened(logs[1], rig=patch).rig.mounts["lidar_top_link"].translation_m.tolist() == [0, 0, 9]


def test_an_edge_by_the_name_of_a_sensor_hangs_on_the_body_of_the_log(logs):
    sensors = {"top": SensorSetup(TOPIC, "lidar"), "left": SensorSetup("/sensing/radar/front_left/detections", "radar")}
    patch = RigPatch({"top": Edge("body", np.array([0.0, 0, 9]), UPRIGHT)})
    rig = opened(logs[1], sensors=sensors, rig=patch).rig
    assert rig.mounts["top"].translation_m.tolist() == [0, 0, 9]
    plain = opened(logs[1], sensors=sensors).rig
    assert rig.mounts["left"].equals(plain.mounts["left"])


def test_a_parent_of_the_log_may_be_named(logs):
    patch = RigPatch({"lidar_top_link": Edge("mast", np.array([0.0, 0, 1]), UPRIGHT)})
    np.testing.assert_allclose(opened(logs[1], rig=patch).rig.mounts["lidar_top_link"].translation_m, [0.4, 0, 2.2])


def test_truth_moves_with_its_coordinate_frame(logs):
    patch = RigPatch({"base_link": Edge("chassis", np.array([1.0, 0, 0]), UPRIGHT)})
    plain, moved = (next(opened(logs[1], **s).truths()) for s in ({}, {"rig": patch, "body": "chassis"}))
    np.testing.assert_allclose(moved.boxes3d.center_m, plain.boxes3d.center_m + np.array([1, 0, 0]))


def test_a_loop_is_one_line(logs):
    patch = RigPatch({"mast": Edge("lidar_top_link", np.zeros(3), UPRIGHT), "lidar_top_link": Edge("mast", np.zeros(3), UPRIGHT)})  # fmt: skip # noqa: E501
    with pytest.raises(LogError, match="transforms form a loop"):
        opened(logs[1], rig=patch).rig  # noqa: B018


def test_the_body_may_be_a_coordinate_frame_beside_the_sensors(logs):
    rig = opened(logs[1], body="lidar_top_link").rig
    plain = open_log(logs[1], FaultLog()).rig
    left = plain.mounts["radar_front_link_left"].translation_m - plain.mounts["lidar_top_link"].translation_m
    np.testing.assert_allclose(rig.mounts["radar_front_link_left"].translation_m, left, atol=1e-12)
    assert rig.mounts["lidar_top_link"].translation_m.tolist() == [0, 0, 0]


def test_classes_of_others_get_the_labels_that_are_wanted(logs):
    labels = [truth.boxes3d.label for truth in opened(logs[1], classes={"car": "van"}).truths()]
    assert "car" not in np.concatenate(labels)


def test_classes_that_mean_nothing_are_counted_once(logs, tmp_path):
    rows = ["frame,x,y,z,length,width,height,yaw,label", *(f"{i},9,0,0,4,2,1,0,ufo 7" for i in range(3))]
    (tmp_path / "labels.csv").write_text("\n".join(rows))
    source = BoxSource(tmp_path / "labels.csv")
    faults = FaultLog()
    found = list(open_log(logs[1], faults, (), Setup(truth=source)).truths())
    assert [truth.boxes3d.label.tolist() for truth in found] == [["other"]] * 3
    assert faults.counts["GT007"] == 1
    assert faults.places["GT007"] == ["drive.mcap: labels.csv: 'ufo 7'"]
    faults = FaultLog()
    found = list(open_log(logs[1], faults, (), Setup(truth=source, classes={"ufo 7": "bus"})).truths())
    assert found[0].boxes3d.label.tolist() == ["bus"]
    assert faults.counts["GT007"] == 0


def test_static_transforms_are_taken_from_any_file_of_a_split_recording(logs, tmp_path):
    """Here they are recorded last, in a file of their own: who joins late gets them when it joins."""
    folder = tmp_path / "split"
    folder.mkdir()
    with logs[1].open("rb") as source:
        every = list(make_reader(source).iter_messages())
    last_ns = max(message.log_time for _, _, message in every)
    for number, is_static in ((0, False), (1, True)):
        with (folder / f"drive_{number}.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2")
            for schema, channel, message in every:
                if (channel.topic == "/tf_static") == is_static:
                    about = writer.register_schema(schema.name, schema.encoding, schema.data)
                    id_ = writer.register_channel(channel.topic, channel.message_encoding, about)
                    writer.add_message(id_, last_ns + 1 if is_static else message.log_time, message.data, 0)
            writer.finish()
    plain, split = open_log(logs[1], FaultLog()), open_log(folder, FaultLog())
    assert split.rig.list_changes(plain.rig) == ()
    assert not [m for m in split.messages() if isinstance(m, RigChange)]


def test_changes_of_the_calibration_are_in_a_rewritten_log(tmp_path):
    low, high = (Rig({"top": Mount("lidar", np.array([0, 0, z]), UPRIGHT)}, {}) for z in (2.0, 2.5))
    with McapWriter(tmp_path / "own.mcap", LogInfo("own", "id"), low) as log:
        for number in range(4):
            if number == 2:
                log.write_rig(number * 100_000_000, high)
            stamp_ns = number * 100_000_000
            log.write(PointCloud("top", stamp_ns, stamp_ns, np.ones((3, 3), np.float32)))
    runpy.run_path(str(EXAMPLE))["rewrite"](tmp_path / "own.mcap", tmp_path / "ros.mcap")
    own, ros = (open_log(tmp_path / name, FaultLog()) for name in ("own.mcap", "ros.mcap"))
    assert [isinstance(item, RigChange) for item in ros.messages()] == [
        isinstance(m, RigChange) for m in own.messages()
    ]
    assert ros.rig.mounts["lidar_top_link"].translation_m[2] == pytest.approx(2.0)
    (change,) = [item for item in ros.messages() if isinstance(item, RigChange)]
    assert change.rig.mounts["lidar_top_link"].translation_m[2] == pytest.approx(2.5)
