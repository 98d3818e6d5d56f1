"""Damaged payloads: a message or a DecodeError of one line, nothing else, and no memory beyond the payload's size."""

import tracemalloc
from functools import cache

import numpy as np
import pytest
from tests.replay.logs.codecs.ros import test_boxes, test_calibration, test_images, test_lidars, test_radar
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, Ros, cloud, structured

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.container import Channel, Schema

NUM_FUZZ = 300
XYZ = {axis: np.float32([1, 2]) for axis in "xyz"}
ROWS = structured(**XYZ, ring=np.uint8([0, 1]), t=np.uint32([0, 1]))
DOPPLER = structured(**XYZ, vr=np.float32([3, 4]))


@cache
def payloads(distro):
    """Name, kind and payload of one message of every type."""
    known = {**test_boxes.NEW, **test_radar.SCANS, test_calibration.TF2: test_calibration.TEXT}
    known |= {**test_lidars.VELODYNE, **test_lidars.HESAI, **test_lidars.livox("livox_ros_driver")}
    ros = Ros(distro, known)
    flat = ros.make(
        "vision_msgs/msg/Detection2D", ros.header(""), test_boxes.results(ros, [("car", 0.5)], "new"),
        test_boxes.flat_box(ros), "1",
    )  # fmt: skip
    scan = ros.make(test_radar.SCAN, ros.header(), [ros.make(test_radar.RETURN, 1.0, 0.0, 0.0, 1.0, 0.0)] * 2)
    rows = [([("car", 0.5)], test_boxes.box3d(ros), "lidar", "12")]
    return ros.encoding, [
        ("sensor_msgs/msg/PointCloud2", "lidar", ros.write(cloud(ros, ROWS))),
        ("sensor_msgs/msg/PointCloud2", "radar", ros.write(cloud(ros, DOPPLER))),
        (test_images.RAW, "camera", test_images.raw(ros)),
        (test_images.COMPRESSED, "camera", test_images.compressed("png", test_images.encoded(".png"), ros)),
        (test_calibration.INFO, "calibration", test_calibration.info(ros)),
        (test_calibration.TF2, "transform", test_calibration.transforms(ros, test_calibration.TF2)),
        (test_boxes.ARRAY3, "truth", test_boxes.array3(ros, rows)),
        (test_boxes.ARRAY2, "truth", ros.write(ros.make(test_boxes.ARRAY2, ros.header("cam"), [flat]))),
        (test_radar.SCAN, "radar", ros.write(scan)),
        *((message.__msgtype__, "lidar", ros.write(message)) for message in test_lidars.small_messages(ros)),
    ]


def use(codec, kind, data):
    match kind:
        case "calibration":
            codec.calibration(data)
        case "transform":
            codec.transforms(data)
            codec.stamps(data)
        case "truth" | "detections":
            codec.truth(data, ORIGIN)
        case _:
            codec.message(kind, data, ORIGIN)


def damaged(data, random):
    """Flip bits, overwrite a word, cut off or add bytes."""
    copy, at = bytearray(data), int(random.integers(len(data)))
    match int(random.integers(4)):
        case 0:
            copy[at] ^= 1 << int(random.integers(8))
        case 1:
            copy[at : at + 4] = random.choice([b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\0\0\xf0\x7f"])
        case 2:
            del copy[at:]
        case _:
            copy += bytes(int(random.integers(1, 40)))
    return memoryview(bytes(copy))


CASES = [(d, i) for d in (DISTROS[1], DISTROS[2]) for i in range(13)]


@pytest.mark.parametrize(("distro", "index"), CASES, ids=lambda v: str(getattr(v, "value", v)))
def test_fuzz(distro, index):
    encoding, messages = payloads(distro)
    name, kind, data = messages[index]
    codec = ros_codec(Channel("/t", encoding, Schema(name, "", b"")))
    use(codec, kind, data)
    random = np.random.Generator(np.random.Philox(index))
    lines: list[str] = []
    for _ in range(NUM_FUZZ):
        changed = damaged(data, random)
        for step in (lambda p=changed: codec.probe(p), lambda p=changed: use(codec, kind, p)):
            try:
                step()
            except DecodeError as error:
                lines.append(str(error))
    assert len(lines) > NUM_FUZZ / 5
    assert not any("\n" in line for line in lines)


@pytest.mark.parametrize(("distro", "index"), CASES, ids=lambda v: str(getattr(v, "value", v)))
def test_every_cut_is_noticed(distro, index):
    encoding, messages = payloads(distro)
    name, kind, data = messages[index]
    codec = ros_codec(Channel("/t", encoding, Schema(name, "", b"")))
    for end in range(len(data)):
        with pytest.raises(DecodeError):
            use(codec, kind, data[:end])


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (b"", "encapsulation 0x isn't supported"),
        (b"\0\7\0\0", "encapsulation 0x0007 isn't supported"),
        (b"\0\3\0\0", "encapsulation 0x0003 isn't supported"),
        (b"\1\0\0\0", "encapsulation 0x0100 isn't supported"),
    ],
)
def test_other_encapsulations(head, message):
    codec = ros_codec(Channel("/t", "cdr", Schema("sensor_msgs/msg/Image", "", b"")))
    with pytest.raises(DecodeError, match=message):
        codec.probe(memoryview(head + bytes(50) if head else b""))


def test_strings():
    codec = ros_codec(Channel("/t", "cdr", Schema("sensor_msgs/msg/CompressedImage", "", b"")))
    head = b"\0\1\0\0" + bytes(8)
    assert codec.probe(memoryview(head + bytes(12))).frame_id == ""  # lengths of 0
    for text, message in ((b"\xff\0", "isn't UTF-8"), (b"ab", "doesn't end with a zero")):
        with pytest.raises(DecodeError, match=message):
            codec.probe(memoryview(head + b"\2\0\0\0" + text + bytes(10)))


BOMBS = [
    ("sensor_msgs/msg/PointCloud2", "lidar", 12, "cloud has 4294967295 fields"),
    ("radar_msgs/msg/RadarScan", "radar", 4, "Invalid sequence length 4294967295"),
    ("vision_msgs/msg/Detection3DArray", "truth", 4, "Invalid sequence length 4294967295"),
]


@pytest.mark.parametrize(("name", "kind", "gap", "message"), BOMBS)
def test_lengths_are_checked_before_memory_is_taken(name, kind, gap, message):
    codec = ros_codec(Channel("/t", "cdr", Schema(name, "", b"")))
    data = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3) + bytes(gap - 4) + b"\xff\xff\xff\xff" + bytes(4096)
    tracemalloc.start()
    with pytest.raises(DecodeError, match=message):
        use(codec, kind, memoryview(data))
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_messages_without_bulk_data_have_a_limit():
    codec = ros_codec(Channel("/t", "cdr", Schema("tf2_msgs/msg/TFMessage", "", b"")))
    with pytest.raises(DecodeError, match="tf2_msgs/msg/TFMessage of 8388609 bytes, more than 8388608"):
        codec.transforms(memoryview(bytes(8 * 1024 * 1024 + 1)))
