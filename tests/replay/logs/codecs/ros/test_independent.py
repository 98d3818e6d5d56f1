"""MCAP files that mcap-ros2-support writes and reads: what it decodes and what we decode agree field by field."""

from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP, STAMP_NS, Ros, structured
from tests.replay.logs.codecs.ros.test_boxes import ARRAY3, NEW
from tests.replay.logs.codecs.ros.test_calibration import INFO, TF2

from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.container import Channel, Schema

CLOUD, IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"
HEADER = {"stamp": {"sec": STAMP[0], "nanosec": STAMP[1]}, "frame_id": "frame"}


def written(name, message):
    """Codec of the channel, and the payload that Writer made of a message."""
    file = BytesIO()
    writer = Writer(file)
    text = Ros(DISTROS[1], NEW if name == ARRAY3 else None).schema(name).data.decode()
    writer.write_message("/topic", writer.register_msgdef(name, text), message, 5, 3)
    writer.finish()
    file.seek(0)
    ((schema, channel, record),) = make_reader(file).iter_messages()
    given = Channel(channel.topic, channel.message_encoding, Schema(schema.name, schema.encoding, schema.data))
    return ros_codec(given), memoryview(record.data)


def test_cloud():
    rows = structured(x=np.float32([1, 2]), y=np.float32([3, 4]), z=np.float32([5, 6]), ring=np.uint16([7, 8]))
    fields = [
        {"name": name, "offset": offset, "datatype": code, "count": 1}
        for name, offset, code in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("ring", 12, 4))
    ]
    codec, data = written(
        CLOUD,
        {
            "header": HEADER, "height": 1, "width": 2, "fields": fields, "is_bigendian": False, "point_step": 14,
            "row_step": 28, "data": rows.tobytes(), "is_dense": True,
        },
    )  # fmt: skip
    cloud = codec.message("lidar", data, ORIGIN)
    assert codec.probe(data)[:2] == ("lidar", "frame")
    assert cloud.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(cloud.xyz, [[1, 3, 5], [2, 4, 6]])
    np.testing.assert_array_equal(cloud.ring, [7, 8])


def test_image():
    pixels = bytes(range(12))
    message = {"height": 2, "width": 2, "encoding": "rgb8", "is_bigendian": 0, "step": 6, "data": pixels}
    codec, data = written(IMAGE, {"header": HEADER, **message})
    image = codec.message("camera", data, ORIGIN)
    assert (image.data, image.encoding, image.size_wh, image.stamp_ns) == (pixels, "rgb8", (2, 2), STAMP_NS)


def test_transforms():
    pose = {"translation": {"x": 1, "y": 2, "z": 3}, "rotation": {"x": 0.5, "y": 0.5, "z": 0.5, "w": 0.5}}
    codec, data = written(TF2, {"transforms": [{"header": HEADER, "child_frame_id": "child", "transform": pose}]})
    ((child, edge),) = codec.transforms(data)
    assert (child, edge.parent) == ("child", "frame")
    assert edge.translation_m.tolist() == [1, 2, 3]
    assert edge.rotation_xyzw.tolist() == [0.5] * 4


def test_detections():
    pose = {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 1, "w": 1}}
    result = {"hypothesis": {"class_id": "car", "score": 0.5}, "pose": {"pose": pose, "covariance": [0.0] * 36}}
    box = {"center": pose, "size": {"x": 4, "y": 2, "z": 1}}
    codec, data = written(
        ARRAY3, {"header": HEADER, "detections": [{"header": HEADER, "results": [result], "bbox": box, "id": "7"}]}
    )
    part = codec.truth(data, ORIGIN)
    boxes = part.truth.boxes3d
    assert (part.frame_id, part.truth.stamp_ns) == ("frame", STAMP_NS)
    assert (boxes.center_m.tolist(), boxes.size_lwh_m.tolist()) == ([[1, 2, 3]], [[4, 2, 1]])
    np.testing.assert_allclose(boxes.yaw_rad, [np.pi / 2])
    assert (boxes.label.tolist(), boxes.score.tolist(), boxes.track_id.tolist()) == (["car"], [0.5], [7])


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.mark.parametrize(
    ("topic", "count"),
    [
        ("/tf_static", 1), ("/kitti/camera_color_left/image_raw", 12), ("/kitti/camera_color_left/camera_info", 12),
        ("/kitti/velodyne_points", 12),
    ],
)  # fmt: skip
def test_a_recording_of_another_tool(shared, topic, count):
    with (shared / "data/mcap/kitti_raw_12frames_ros2.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = 0
        for schema, channel, record, other in reader.iter_decoded_messages(topics=[topic]):
            given = Channel(channel.topic, channel.message_encoding, Schema(schema.name, schema.encoding, schema.data))
            COMPARE[schema.name](ros_codec(given), memoryview(record.data), other)
            seen += 1
    assert seen == count


def compare_transforms(codec, data, other):
    edges = codec.transforms(data)
    assert len(edges) == len(other.transforms) == 2
    for (child, edge), stamped in zip(edges, other.transforms, strict=True):
        t, q = stamped.transform.translation, stamped.transform.rotation
        assert (child, edge.parent) == (stamped.child_frame_id, stamped.header.frame_id)
        assert edge.translation_m.tolist() == [t.x, t.y, t.z]
        assert edge.rotation_xyzw.tolist() == [q.x, q.y, q.z, q.w]


def compare_images(codec, data, other):
    image = codec.message("camera", data, ORIGIN)
    assert (image.stamp_ns, image.encoding) == (stamp_ns(other), other.encoding)
    assert (image.size_wh, image.data) == ((other.width, other.height), bytes(other.data))


def compare_calibrations(codec, data, other):
    frame, camera = codec.calibration(data)
    assert (frame, camera.size_wh) == (other.header.frame_id, (other.width, other.height))
    assert (camera.K.ravel().tolist(), camera.distortion.tolist()) == (list(other.k), list(other.d))
    assert camera.distortion_model == other.distortion_model


def compare_clouds(codec, data, other):
    cloud = codec.message("lidar", data, ORIGIN)
    raw = np.frombuffer(bytes(other.data), np.uint8).reshape(-1, other.point_step)
    offsets = {field.name: field.offset for field in other.fields}
    columns = {name: raw[:, at : at + 4].copy().view("<f4")[:, 0] for name, at in offsets.items()}
    assert cloud.stamp_ns == stamp_ns(other)
    np.testing.assert_array_equal(cloud.xyz, np.stack([columns[axis] for axis in "xyz"], axis=1))
    np.testing.assert_array_equal(cloud.intensity, columns["intensity"])


COMPARE = {TF2: compare_transforms, IMAGE: compare_images, INFO: compare_calibrations, CLOUD: compare_clouds}
