"""Video in messages of ROS, written by rosbags."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP_NS, Ros
from tests.replay.logs.codecs.video import builders as v

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.data.images import decode, encode_jpeg
from fbench.replay.data.messages import Image

FOXGLOVE = "foxglove_msgs/msg/CompressedVideo"
FFMPEG, OLD = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "ffmpeg_image_transport/msg/FFMPEGPacket"
PLAIN, CLEARPATH, THEORA = (
    "h264_msgs/msg/Packet",
    "h264_image_transport/msg/H264Packet",
    "theora_image_transport/msg/Packet",
)
DEFINITIONS = {
    FOXGLOVE: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    FFMPEG: "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
    "bool is_bigendian\nuint8[] data\n",
    PLAIN: "std_msgs/Header header\nuint64 seq\nuint8[] data\n",
    CLEARPATH: "std_msgs/Header header\nuint8[] data\n",
    OLD: "std_msgs/Header header\nuint8[] data\nint32 img_width\nint32 img_height\nstring encoding\nuint64 pts\n"
    "uint8 flags\n",
    THEORA: "std_msgs/Header header\nuint8[] data\nint32 b_o_s\nint32 e_o_s\nint64 granulepos\nint64 packetno\n",
}  # fmt: skip
ROS2, ROS1 = (Ros(distro, DEFINITIONS) for distro in (DISTROS[1], DISTROS[2]))
PACKETS = v.encode(num=4)
HEVC = v.encode("h265", num=4)


def payload(ros, name, packet, encoding="h264", frame_id="cam"):
    data, header = np.frombuffer(packet, np.uint8), ros.header(frame_id)
    more = {
        FOXGLOVE: {"timestamp": ros.time(), "frame_id": frame_id, "format": encoding},
        FFMPEG: {"header": header, "width": 96, "height": 64, "encoding": encoding, "pts": 3, "flags": 1,
                 "is_bigendian": False},
        OLD: {"header": header, "img_width": 96, "img_height": 64, "encoding": encoding, "pts": 3, "flags": 1},
        PLAIN: {"header": header, "seq": 4},
        CLEARPATH: {"header": header},
        THEORA: {"header": header, "b_o_s": 0, "e_o_s": 0, "granulepos": 0, "packetno": 0},
        "sensor_msgs/msg/CompressedImage": {"header": header, "format": encoding},
    }[name]  # fmt: skip
    return ros.write(ros.make(name, **more, data=data))


@pytest.mark.parametrize(
    ("ros", "name", "encoding", "codec"),
    [
        (ROS2, FOXGLOVE, "h264", "h264"),
        (ROS2, FOXGLOVE, "h265", "h265"),
        (ROS1, FOXGLOVE, "h264", "h264"),
        (ROS2, FFMPEG, "h264;yuv420p;bgr8;bgr8", "h264"),
        (ROS2, FFMPEG, "hevc_nvenc", "h265"),
        (ROS2, FFMPEG, "libx264", "h264"),
        (ROS1, OLD, "hevc", "h265"),
        (ROS2, PLAIN, "", "h264"),
        (ROS1, CLEARPATH, "", "h264"),
        (ROS2, "sensor_msgs/msg/CompressedImage", "h264", "h264"),
        (ROS1, "sensor_msgs/msg/CompressedImage", "h265", "h265"),
    ],
)
def test_messages(ros, name, encoding, codec):
    packets = PACKETS if codec == "h264" else HEVC
    data = payload(ros, name, packets[0], encoding)
    reader = ros.codec(name)
    assert reader.kinds == ("camera",)
    assert reader.probe(data) == ("camera", "cam", "", "")
    image = reader.message("camera", data, ORIGIN)
    assert (image.data, image.encoding, image.size_wh) == (packets[0], codec, v.SIZE)
    assert (image.sensor, image.stamp_ns, image.log_ns, image.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    later = reader.message("camera", payload(ros, name, packets[1], encoding), ORIGIN)
    assert later.size_wh == (v.SIZE if name in (FFMPEG, OLD) else (0, 0))


@pytest.mark.parametrize("name", [FOXGLOVE, FFMPEG, PLAIN])
def test_recordings_without_definitions(name):
    """Those of ROS 2 Humble in SQLite."""
    data = payload(ROS2, name, PACKETS[0])
    image = ROS2.codec(name, text=False).message("camera", data, ORIGIN)
    assert (image.data, image.encoding) == (PACKETS[0], "h264")


def test_images_under_the_names_of_video():
    jpeg = encode_jpeg(v.pictures(1)[0])
    for name, encoding in ((FFMPEG, "mjpeg"), ("sensor_msgs/msg/CompressedImage", "h264")):
        image = ROS2.codec(name).message("camera", payload(ROS2, name, jpeg, encoding), ORIGIN)
        assert (image.encoding, image.size_wh, image.data) == ("jpeg", v.SIZE, jpeg)


@pytest.mark.parametrize(
    ("name", "encoding", "why"),
    [
        (FOXGLOVE, "vp8", "video in 'vp8' isn't supported, only h264, h265, vp9, av1"),
        (FFMPEG, "mpeg4", "video in 'mpeg4' isn't supported"),
        (THEORA, "", "its video is Theora, which isn't supported; record images, or another transport"),
    ],
)
def test_other_forms_are_refused_by_name(name, encoding, why):
    with pytest.raises(UnsupportedError, match=why):
        ROS2.codec(name).probe(payload(ROS2, name, PACKETS[0], encoding))


def write_ros2(path, name):
    with Writer2(path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/cam/ffmpeg", name, typestore=ROS2.store)
        for i, packet in enumerate(PACKETS):
            writer.write(connection, STAMP_NS + i, bytes(payload(ROS2, name, packet)))
    return path / "bag"


def write_ros1(path, name):
    with Writer1(path / "log.bag") as writer:
        connection = writer.add_connection("/cam/ffmpeg", name, typestore=ROS1.store)
        for i, packet in enumerate(PACKETS):
            writer.write(connection, STAMP_NS + i, bytes(payload(ROS1, name, packet)))
    return path / "log.bag"


@pytest.mark.parametrize(("write", "name"), [(write_ros2, FFMPEG), (write_ros1, OLD)])
def test_bags(tmp_path, write, name):
    reader, faults = b.read(write(tmp_path, name))
    images = b.numbers(list(reader.messages()), Image)
    assert [image.sensor for image in images] == ["cam"] * 4
    for image, frame in zip(images, v.decode_all("h264", PACKETS), strict=True):
        v.require_same(decode(image), v.to_bgr(frame))
    assert set(faults.counts) <= {"LOG003", "LOG006"}  # no index, no checksums


def test_theora_is_left_out_by_name(tmp_path):
    reader, faults = b.read(write_ros2(tmp_path, THEORA))
    assert list(reader.messages()) == []
    assert "is left out: its video is Theora" in faults.places["LOG013"][0]
