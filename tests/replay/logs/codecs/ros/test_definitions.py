"""Definitions in logs: the one that a log carries wins, and hostile ones can do nothing."""

import subprocess
import sys

import numpy as np
import pytest
from tests.cli.test_recorded import boxes, drive, write
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, Ros, cloud, structured
from tests.replay.logs.codecs.ros.test_boxes import ARRAY3
from tests.replay.logs.codecs.ros.test_calibration import INFO, TF2

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.open import open_log

CLOUD = "sensor_msgs/msg/PointCloud2"
LINE = "=" * 80


def codec(name, text, encoding="cdr", schema_encoding="ros2msg"):
    data = text if isinstance(text, bytes) else text.encode()
    return ros_codec(Channel("/t", encoding, Schema(name, schema_encoding, data)))


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("cdr", "sensor_msgs/msg/Imu"), ("cdr", "foxglove.PointCloud"), ("cdr", ""), ("cdr", "a/b/c/d"),
        ("cdr", "sensor_msgs/srv/Image"), ("protobuf", CLOUD), ("json", CLOUD),
    ],
)  # fmt: skip
def test_other_channels_have_no_codec(encoding, name):
    assert codec(name, "hostile definition (((", encoding) is None


def test_channels_without_a_schema_have_no_codec():
    assert ros_codec(Channel("/t", "cdr")) is None


@pytest.mark.parametrize("name", ["sensor_msgs/PointCloud2", CLOUD])
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_both_forms_of_names(name, encoding):
    assert codec(name, "", encoding).kinds == ("lidar", "radar")


OLD_INFO = (
    "Header header\r\nuint32 height\nuint32 width\nfloat64[5] D\nfloat64[9] K # row by row\nfloat64[9] R\n"
    "float64[12] P\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi\nstring distortion_model\n"
    f"{LINE}\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    "bool do_rectify"
)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_a_definition_in_the_log_wins(encoding):
    """A CameraInfo of other fields, whose header is that of the standard."""
    ros = Ros(DISTROS[2] if encoding == "ros1" else DISTROS[1])
    for name in (INFO, "sensor_msgs/msg/RegionOfInterest"):
        del ros.store.fielddefs[name]
    from rosbags.typesys import get_types_from_msg

    ros.store.register(get_types_from_msg(OLD_INFO.replace("\r", ""), INFO))
    roi = ros.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    k = np.array([100.0, 0, 50, 0, 100, 40, 0, 0, 1])
    message = ros.make(INFO, ros.header("cam"), 80, 100, np.arange(5.0), k, k, np.zeros(12), 0, 0, roi, "plumb_bob")
    frame, camera = codec(INFO, OLD_INFO, encoding).calibration(ros.write(message))
    assert (frame, camera.size_wh, camera.distortion_model) == ("cam", (100, 80), "plumb_bob")
    assert camera.distortion.tolist() == [0, 1, 2, 3, 4]


def test_definitions_in_idl_are_replaced_by_the_standard_ones():
    ros = Ros(DISTROS[1])
    data = ros.write(cloud(ros, structured(x=np.float32([1]), y=np.float32([2]), z=np.float32([3]))))
    hostile = "module a { const long b = " + "(" * 50 + "1" + ")" * 50 + "; };"
    assert codec(CLOUD, hostile, schema_encoding="ros2idl").message("lidar", data, ORIGIN).xyz.tolist() == [[1, 2, 3]]


def test_a_cloud_of_another_definition_is_refused():
    with pytest.raises(DecodeError, match="definition of sensor_msgs/msg/PointCloud2 isn't the standard one"):
        codec(CLOUD, "std_msgs/Header header\nuint8[] data")


HEAD = "std_msgs/Header header\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("(", "can't be parsed"),
        ("uint8[ a", "can't be parsed"),
        (b"\xff\xfe", "isn't UTF-8"),
        ("x" * 70_000, "has 70000 bytes, more than 65536"),
        ("uint8 A=" + "9" * 5000, "can't be parsed"),
        ("uint8[" + "9" * 5000 + "] a", "can't be parsed"),
        ("float64 A=1e999\nuint8[] a\nuint8 structure_needs_at_least_one_member\nuint8 b", "can't be used"),
        ("uint8 a\nuint8 a", "can't be used"),
        ("uint8[0] a", "array 'a' of 0, 1 to 4096 are read"),
        ("uint8[-1] a", "array 'a' of -1"),
        ("uint8[1000000000000] a", "array 'a' of 1000000000000"),
        ("string[65] a", "array 'a' of 65, 1 to 64 are read"),
        ("std_msgs/Header[65] a", "array 'a' of 65"),
        (f"{HEAD}std_msgs/Header[64] a\nstd_msgs/Header[64] b", "has .* parts, more than 256"),
        ("Missing[] a", "definition of sensor_msgs/msg/Missing is missing"),
        ("wstring a", "definition of sensor_msgs/msg/wstring is missing"),
        ("sensor_msgs/CameraInfo a", "definition of sensor_msgs/msg/CameraInfo contains itself"),
        (f"a/B a\n{LINE}\nMSG: a/B\na/C c\n{LINE}\nMSG: a/C\na/B b", "contains itself"),
        (f"a/B[] a\n{LINE}\nMSG: a/B\nuint8 c", "repeats 'a' of 1 parts in 1 bytes"),
        (f"a/B[] a\n{LINE}\nMSG: a/B\n", "repeats 'a' of 1 parts in 0 bytes"),
        ("\n".join(f"uint8 a{i}" for i in range(257)), "more than 32 types or 256 fields"),
        ("uint8 " + "a" * 65, "which isn't a name"),
        (f"a/b/msg/C a\n{LINE}\nMSG: a/b/msg/C\nuint8 a", "isn't the name of a message type"),
    ],
)
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_hostile_definitions(text, message, encoding):
    with pytest.raises(DecodeError, match=message):
        codec(INFO, text, encoding).calibration(memoryview(bytes(200)))


def test_many_types():
    text = "".join(f"a/T{i} t{i}\n" for i in range(40))
    text += "".join(f"{LINE}\nMSG: a/T{i}\nuint8 a\n" for i in range(40))
    with pytest.raises(DecodeError, match="more than 32 types"):
        codec(INFO, text)


INJECTIONS = [
    "uint8 a\nstring B=\"'''\\n__import__('os').system('touch {marker}')\"",
    "string B=__import__('os').system('touch {marker}')",
    'string B="""\n\'\'\'\nimport os; os.system("touch {marker}")',
    "uint8 a = __import__('os').system('touch {marker}')",
    "uint8 a; __import__('os').system('touch {marker}')",
    "uint8 import\nuint8 class\nuint8 T\nuint8 dataclass\nuint8 ClassVar\nuint8 cls\nuint8 None",
    LINE + "\nMSG: a/msg/B\"];__import__('os').system('touch {marker}')#\nuint8 a",
    LINE + "\nMSG: os/system\nuint8 a",
]


@pytest.mark.parametrize("text", INJECTIONS)
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_definitions_cant_inject_code(text, encoding, tmp_path):
    marker = tmp_path / "marker"
    for hostile in (text, "uint8 first\n" + text):
        with pytest.raises(DecodeError):
            codec(INFO, hostile.replace("{marker}", str(marker)), encoding).calibration(
                memoryview(b"\0\1\0\0" + bytes(9))
            )
    assert not marker.exists()


@pytest.mark.parametrize("name", [INFO, TF2, ARRAY3])
def test_definitions_with_changed_bytes_give_clear_errors(name):
    """Thousands of texts one character away from a real one: a codec or a DecodeError."""
    ros = Ros(DISTROS[1])
    text = ros.schema(name).data if name in ros.store.fielddefs else b"std_msgs/Header header\nuint8[] detections\n"
    random = np.random.Generator(np.random.Philox(4))
    lines: list[str] = []
    alphabet = b"\n\t []<=0123456789az_/#'\"@\\:{}()\x00\xff"
    for _ in range(150):
        damaged = bytearray(text)
        for _ in range(int(random.integers(1, 4))):
            damaged[int(random.integers(len(damaged)))] = alphabet[int(random.integers(len(alphabet)))]
        try:
            codec(name, bytes(damaged)).probe(memoryview(b"\0\1\0\0" + bytes(400)))
        except DecodeError as error:
            lines.append(str(error))
    assert lines
    assert not any("\n" in line for line in lines)


@pytest.mark.slow
def test_rosbags_is_imported_when_a_log_has_ros_messages():
    code = (
        "import sys; from fbench.replay.logs.codecs.ros.codec import ros_codec; "
        "from fbench.replay.logs.container import Channel; assert ros_codec(Channel('/t', 'protobuf')) is None; "
        "assert not [m for m in sys.modules if m.startswith('rosbags')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_topics_of_one_type_share_what_its_definition_took(tmp_path):
    """Thousands of topics would else take minutes and gigabytes."""
    tracks = [(1, f"/tracks/{i}", ARRAY3, boxes(0, (1, 10, 0))) for i in range(20)]
    found = open_log(write(tmp_path / "log.mcap", *drive(*tracks)), FaultLog()).roles.values()
    codecs = [role.codec for role in found if role.topic.startswith("/tracks/")]
    assert len(codecs) == 20
    assert all(codec is codecs[0] for codec in codecs)
    assert next(role.codec for role in found if role.topic == "/lidar") is not codecs[0]
