"""Results that a stack wrote into a log of ROS 2 are scored like those of any pipeline."""

import json

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from tests.replay.logs.codecs.ros.builders import DISTROS, Ros, cloud, structured
from tests.replay.logs.codecs.ros.test_boxes import ARRAY3, NEW, box3d, results

MS = 1_000_000
START_S = 1_700_000_000
ROS = Ros(DISTROS[1], NEW)
LIDAR = structured(x=np.array([5.0, 6.0], "f4"), y=np.zeros(2, "f4"), z=np.ones(2, "f4"))


def stamp(ms):
    return START_S + ms // 1000, ms % 1000 * MS


def boxes(ms, *rows, frame_id="base_link"):
    """Rows of id, x and y."""
    parts = [
        ROS.make(
            "vision_msgs/msg/Detection3D", ROS.header(frame_id, stamp(ms)), results(ROS, [("car", 0.5)], "new"),
            box3d(ROS, (float(x), float(y), 0.75)), str(id_),
        )
        for id_, x, y in rows
    ]  # fmt: skip
    return ROS.write(ROS.make(ARRAY3, ROS.header(frame_id, stamp(ms)), parts))


def static(*children):
    zero, unit = ROS.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    edges = [
        ROS.make(
            "geometry_msgs/msg/TransformStamped", ROS.header("base_link", stamp(0)), child,
            ROS.make("geometry_msgs/msg/Transform", zero, ROS.make("geometry_msgs/msg/Quaternion", *unit)),
        )
        for child in children
    ]  # fmt: skip
    return ROS.write(ROS.make("tf2_msgs/msg/TFMessage", edges))


def write(path, *items):
    """Write (ms of recording, topic, type, payload)."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        channels = {}
        for ms, topic, name, data in sorted(items, key=lambda item: item[:2]):
            if topic not in channels:
                schema = ROS.schema(name)
                id_ = writer.register_schema(name, schema.encoding, schema.data)
                channels[topic] = writer.register_channel(topic, "cdr", id_)
            ns = START_S * 1000 * MS + ms * MS
            writer.add_message(channels[topic], ns, bytes(data), ns)
        writer.finish()
    return path


def drive(*tracks):
    """Six frames, in each two cars at 10 and 20 m."""
    yield 0, "/tf_static", "tf2_msgs/msg/TFMessage", static("lidar")
    for ms in range(0, 600, 100):
        yield ms + 1, "/lidar", "sensor_msgs/msg/PointCloud2", ROS.write(cloud(ROS, LIDAR, stamp=stamp(ms)))
        yield ms + 2, "/ground_truth", ARRAY3, boxes(ms, (1, 10, 0), (2, 20, 3))
    yield from tracks


def known_errors():
    """Both cars, but not the second one in the first two frames; a ghost in one frame; and one frame without any."""
    for i, ms in enumerate(range(0, 500, 100)):
        rows = [(7, 10.5, 0)] + ([(8, 20, 3.25)] if i >= 2 else []) + ([(9, 30, -5)] if i == 3 else [])
        yield ms + 80 + i, "/tracks", ARRAY3, boxes(ms, *rows)


def score(run, metric):
    rows = json.loads((run / "scores.json").read_text())
    return next(row for row in rows if row["metric"] == metric and row["class"] == "vehicle" and row["slice"] == "all")


@pytest.mark.slow
def test_known_errors_give_the_scores_that_one_counts_by_hand(fbench, tmp_path):
    log = write(tmp_path / "log.mcap", *drive(*known_errors()))
    result = fbench("replay", log, "-p", "recorded:/tracks", "-o", "run", "--all-around", "--report")
    assert result.code == 0, result.err
    # 12 cars; 8 of them found, and one ghost.
    assert score(tmp_path / "run", "f1")["value"] == pytest.approx(2 * 8 / (2 * 8 + 1 + 4))
    assert score(tmp_path / "run", "mota")["value"] == pytest.approx(1 - (1 + 4 + 0) / 12)
    assert score(tmp_path / "run", "idsw")["value"] == 0
    latency = json.loads((tmp_path / "run" / "latency.json").read_text())
    assert latency["clock"] == "log"
    [recorded, total] = latency["stages"]
    assert (recorded["stage"], total["stage"]) == ("recorded", "total")
    assert (total["count"], total["first_ms"], total["p50_ms"], total["max_ms"]) == (5, None, 82, 84)
    assert "latency is from times of recording" in result.out
    assert "Times of recording" in (tmp_path / "run" / "report.html").read_text()


def test_truth_against_itself(fbench, tmp_path):
    log = write(tmp_path / "log.mcap", *drive())
    result = fbench("replay", log, "-p", "recorded:/ground_truth", "-o", "run", "--all-around")
    assert result.code == 0, result.err
    assert (score(tmp_path / "run", "f1")["value"], score(tmp_path / "run", "mota")["value"]) == (1, 1)


def test_own_truth_against_itself(fbench, log, tmp_path):
    result = fbench("replay", log, "-p", "recorded:/truth/boxes", "-o", "run", "--all-around")
    assert result.code == 0, result.err
    assert score(tmp_path / "run", "f1")["value"] == 1
    latency = json.loads((tmp_path / "run" / "latency.json").read_text())
    assert (latency["frames"], latency["over_budget_share"]) == (0, None)  # nobody recorded it at work


def test_topic_that_isnt_there(fbench, tmp_path):
    log = write(tmp_path / "log.mcap", *drive(*known_errors()))
    result = fbench("replay", log, "-p", "recorded:/trakcs", "-o", "run")
    assert result.code == 3
    assert result.err.count("\n") == 1
    assert "no topic '/trakcs' with boxes; did you mean '/tracks'?" in result.err


def test_boxes_in_the_world_without_poses(fbench, tmp_path):
    tracks = ((ms + 80, "/tracks", ARRAY3, boxes(ms, (1, 10, 0), frame_id="map")) for ms in range(0, 600, 100))
    log = write(tmp_path / "log.mcap", *drive(*tracks))
    result = fbench("replay", log, "-p", "recorded:/tracks", "-o", "run")
    assert result.code == 3
    assert result.err.count("\n") == 1


def test_boxes_in_the_world_are_moved_with_the_poses_that_the_user_names(fbench, tmp_path):
    """The body drives 2 m a frame; its stack tracks in the coordinate frame of the odometry."""

    def moved():
        for i, ms in enumerate(range(0, 600, 100)):
            yield ms + 1, "/odom", "geometry_msgs/msg/PoseStamped", ROS.write(pose(ms, 2.0 * i))
            yield ms + 60, "/tracks", ARRAY3, boxes(ms, (1, 10 + 2 * i, 0), (2, 20 + 2 * i, 3), frame_id="odom")

    log = write(tmp_path / "log.mcap", *drive(*moved()))
    (tmp_path / "fbench.toml").write_text('version = 1\n[body]\npose = "/odom"\n')
    result = fbench("replay", log, "-p", "recorded:/tracks", "--config", "fbench.toml", "-o", "run", "--all-around")
    assert result.code == 0, result.err
    assert (score(tmp_path / "run", "f1")["value"], score(tmp_path / "run", "mota")["value"]) == (1, 1)
    assert score(tmp_path / "run", "motp")["value"] == pytest.approx(0, abs=1e-9)


def pose(ms, x):
    point = ROS.make("geometry_msgs/msg/Point", x, 0.0, 0.0)
    where = ROS.make("geometry_msgs/msg/Pose", point, ROS.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    return ROS.make("geometry_msgs/msg/PoseStamped", ROS.header("odom", stamp(ms)), where)
