"""The ROS 2 bridge with fake message classes; what it makes is read back by an independent decoder of CDR."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from fbench.pipelines.external import fbench_exec_pb2 as schema

STORE = get_typestore(Stores.ROS2_HUMBLE)


def message_class(name, **fields):
    """A class as rclpy has it: made without arguments, nested messages are there."""

    def make(self):
        for key, value in fields.items():
            setattr(self, key, value() if callable(value) else value)

    return type(name, (), {"__init__": make})


def header():
    return SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))


def xyzw():
    return SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)


TYPES = SimpleNamespace(
    Clock=message_class("Clock", clock=lambda: SimpleNamespace(sec=0, nanosec=0)),
    PointField=message_class("PointField"),
    PointCloud2=message_class("PointCloud2", header=header),
    Image=message_class("Image", header=header),
    CompressedImage=message_class("CompressedImage", header=header),
    CameraInfo=message_class(
        "CameraInfo", header=header, binning_x=0, binning_y=0,
        roi=lambda: SimpleNamespace(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    ),
    TFMessage=message_class("TFMessage"),
    TransformStamped=message_class(
        "TransformStamped", header=header, transform=lambda: SimpleNamespace(translation=xyzw(), rotation=xyzw())
    ),
)  # fmt: skip


def over_the_wire(message, name):
    """Serialise as ROS does, and decode."""
    if isinstance(getattr(message, "data", None), bytes):
        message.data = np.frombuffer(message.data, np.uint8)
    for field in ("d", "k", "r", "p"):
        if hasattr(message, field):
            setattr(message, field, np.array(getattr(message, field)))
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, name), name)


def test_points(importable):
    conversions = importable("conversions")
    columns = {
        "xyz": np.array([[1, 2, 3], [4, 5, 6]], np.float32),
        "intensity": np.array([0.5, 0.25], np.float32),
        "ring": np.array([7, 65535], np.uint16),
        "offset_ns": np.array([-5, 2**31 - 1], np.int32),
    }
    message = conversions.points(TYPES, "top", 1_700_000_000_123_456_789, columns)
    got = over_the_wire(message, "sensor_msgs/msg/PointCloud2")
    assert (got.header.frame_id, got.header.stamp.sec, got.header.stamp.nanosec) == ("top", 1_700_000_000, 123_456_789)
    assert (got.width, got.height, got.point_step, got.row_step) == (2, 1, 22, 44)
    assert [(f.name, f.offset, f.datatype, f.count) for f in got.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("intensity", 12, 7, 1), ("ring", 16, 4, 1),
        ("offset_ns", 18, 5, 1),
    ]  # fmt: skip
    rows = got.data.view("<f4,<f4,<f4,<f4,<u2,<i4")
    assert [list(row) for row in rows] == [[1, 2, 3, 0.5, 7, -5], [4, 5, 6, 0.25, 65535, 2**31 - 1]]


def test_radar(importable):
    conversions = importable("conversions")
    columns = {"xyz": np.ones((1, 3), np.float32), "radial_velocity_mps": np.array([-3], np.float32)}
    got = over_the_wire(conversions.points(TYPES, "radar", 0, columns), "sensor_msgs/msg/PointCloud2")
    assert [f.name for f in got.fields] == ["x", "y", "z", "velocity"]
    assert got.data.view("<f4").tolist() == [1, 1, 1, -3]


@pytest.mark.parametrize(
    ("encoding", "ros_encoding", "step"), [("rgb8", "rgb8", 6), ("bayer_rggb16", "bayer_rggb16", 4),
                                           ("mono8", "mono8", 2), ("uyvy", "yuv422", 4), ("nv21", "nv21", 2)]
)  # fmt: skip
def test_raw_images(importable, encoding, ros_encoding, step):
    conversions = importable("conversions")
    source = schema.Image(encoding=encoding, width_px=2, height_px=1, data=bytes(range(step)))
    got = over_the_wire(conversions.image(TYPES, "cam", 5, source), "sensor_msgs/msg/Image")
    assert (got.encoding, got.width, got.height, got.step) == (ros_encoding, 2, 1, step)
    assert got.data.tolist() == list(range(step))


def test_compressed_image_and_camera_info(importable):
    conversions = importable("conversions")
    image = conversions.image(TYPES, "cam", 5, schema.Image(encoding="jpeg", data=b"\xff\xd8"))
    assert over_the_wire(image, "sensor_msgs/msg/CompressedImage").data.tolist() == [0xFF, 0xD8]
    camera = schema.Camera(k=range(9), width_px=640, height_px=480, distortion_model="fisheye", distortion=[1, 2, 3, 4])
    message = conversions.camera_info(TYPES, schema.Sensor(name="cam", camera=camera), 5)
    got = over_the_wire(message, "sensor_msgs/msg/CameraInfo")
    assert (got.distortion_model, got.d.tolist(), got.k.tolist()) == ("equidistant", [1, 2, 3, 4], list(range(9)))
    assert got.p.tolist() == [0, 1, 2, 0, 3, 4, 5, 0, 6, 7, 8, 0]


def test_transform(importable):
    conversions = importable("conversions")
    pose = schema.Pose(translation_m=[1, 2, 3], rotation_xyzw=[0.5, -0.5, 0.5, -0.5])
    got = over_the_wire(conversions.transform(TYPES, "base", "cam", 5, pose), "geometry_msgs/msg/TransformStamped")
    assert (got.header.frame_id, got.child_frame_id) == ("base", "cam")
    assert (got.transform.translation.y, got.transform.rotation.w) == (2, -0.5)


def detection(x, yaw=0.0, label="car", score=0.5, name="3"):
    turned = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    center = SimpleNamespace(position=SimpleNamespace(x=x, y=0.0, z=1.0), orientation=turned)
    others = [SimpleNamespace(hypothesis=SimpleNamespace(class_id="truck", score=score / 2))]
    best = SimpleNamespace(hypothesis=SimpleNamespace(class_id=label, score=score))
    bbox = SimpleNamespace(center=center, size=SimpleNamespace(x=4.0, y=2.0, z=1.5))
    return SimpleNamespace(bbox=bbox, results=[*others, best], id=name)


def array(stamp_ns, *detections, frame_id="base_link"):
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    head = SimpleNamespace(frame_id=frame_id, stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
    return SimpleNamespace(header=head, detections=list(detections))


def test_boxes(importable):
    conversions = importable("conversions")
    boxes = schema.Boxes3D()
    conversions.fill_boxes(array(5, detection(10.0, yaw=2.0), detection(20.0, name="x")), "base_link", boxes)
    assert list(boxes.center_m) == [10, 0, 1, 20, 0, 1]
    assert list(boxes.size_lwh_m) == [4, 2, 1.5] * 2
    assert boxes.yaw_rad[0] == pytest.approx(2.0)
    assert (list(boxes.label), list(boxes.score)) == (["car", "car"], [0.5, 0.5])
    assert len(boxes.track_id) == 0  # not all are numbers
    with pytest.raises(ValueError, match="boxes are in frame 'map', expected 'base_link'"):
        conversions.fill_boxes(array(5, frame_id="map"), "base_link", boxes)


@pytest.mark.parametrize("roll", [-1.0, 0.4])
@pytest.mark.parametrize("pitch", [-0.7, 0.2])
@pytest.mark.parametrize("yaw", [-3.0, 1.0])
def test_angles(importable, roll, pitch, yaw):
    from scipy.spatial.transform import Rotation

    conversions = importable("conversions")
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    assert conversions.angles(SimpleNamespace(x=x, y=y, z=z, w=w)) == pytest.approx((roll, pitch, yaw))


class FakeRos:
    types = TYPES

    def __init__(self, *answers):
        self.sent, self.answers = [], list(answers)

    def publish(self, topic, message, keep=False):
        self.sent.append((topic, message, keep))

    def receive(self, timeout_s):
        return self.answers.pop(0) if self.answers else None


def frame():
    xyz = np.ones((2, 3), "<f4").tobytes()
    return schema.Frame(
        stamp_ns=7_000_000_001,
        messages=[
            schema.Message(sensor="cam", stamp_ns=7, log_ns=12, image=schema.Image(encoding="jpeg", data=b"x")),
            schema.Message(sensor="lidar", stamp_ns=8, log_ns=11, points=schema.PointCloud(xyz=xyz)),
            schema.Message(sensor="pose", stamp_ns=9, log_ns=10,
                           pose=schema.Pose(translation_m=[1, 2, 3], rotation_xyzw=[0, 0, 0, 1])),
        ],
    )  # fmt: skip


def test_bridge_publishes_in_order_and_waits_for_the_stamp(importable):
    Bridge = importable("bridge_node").Bridge
    older, mine = ("/found", array(6_000_000_000, detection(1.0))), ("/found", array(7_000_000_001, detection(2.0)))
    tracks = ("/tracks", array(7_000_000_001, detection(3.0)))
    ros = FakeRos(older, ("/other", None), tracks, mine)
    bridge = Bridge(ros, "/found", "/tracks", 1.0)
    camera = schema.Sensor(name="cam", camera=schema.Camera(k=range(9)), translation_m=[0] * 3, rotation_xyzw=[0] * 4)
    lidar = schema.Sensor(name="lidar", translation_m=[0] * 3, rotation_xyzw=[0, 0, 0, 1])
    bridge.start(schema.Hello(sensors=[camera, lidar]))
    assert [(topic, keep) for topic, _, keep in ros.sent] == [("/tf_static", True)]
    assert [t.child_frame_id for t in ros.sent[0][1].transforms] == ["cam", "lidar"]
    output = bridge.step(frame())
    topics = ["/clock", "/tf", "/lidar/points", "/cam/image/compressed", "/cam/camera_info"]
    assert [topic for topic, *_ in ros.sent[1:]] == topics
    assert list(output.in_3d.detections.center_m) == [2, 0, 1]
    assert list(output.in_3d.tracks.track_id) == [3]
    assert [stage.name for stage in output.stages] == ["ros2"]


def test_bridge_gives_up_on_a_stack_that_says_nothing(importable):
    Bridge = importable("bridge_node").Bridge
    bridge = Bridge(FakeRos(), "/found", None, 0.1)
    bridge.start(schema.Hello())
    with pytest.raises(TimeoutError, match="no message with stamp 7000000001 ns on /found"):
        bridge.step(schema.Frame(stamp_ns=7_000_000_001))
