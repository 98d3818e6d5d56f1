"""LaserScan, MultiEchoLaserScan, Livox and Velodyne messages, written by rosbags."""

import numpy as np
import pytest
from rosbags.typesys import Stores
from tests.replay.logs.codecs.oracles.velodyne_packets import STRONGEST, packets
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP, STAMP_NS, Ros
from tests.replay.logs.codecs.test_hesai import packet as hesai_packet

from fbench.replay.contracts.errors import DecodeError, PointsError, UnsupportedError
from fbench.replay.logs.codecs.hesai import decode as decode_hesai
from fbench.replay.logs.codecs.hesai import read_table
from fbench.replay.logs.codecs.ros.lidars import read_nebula
from fbench.replay.logs.codecs.velodyne import SIZE, decode

SCAN, ECHOES, ECHO = (f"sensor_msgs/msg/{name}" for name in ("LaserScan", "MultiEchoLaserScan", "LaserEcho"))
HALF = np.pi / 2
RANGES = [2.0, 3.0, np.inf, np.nan, 0.05, 31.0, 4.0]
INTENSITIES = np.arange(7.0)
every_distro = pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)


def floats(values) -> np.ndarray:
    return np.asarray(values, np.float32)


def planar(ros, name, ranges, intensities, *, start=0.0, step=HALF, pause=0.001, low=0.1, high=30.0):
    return ros.make(name, ros.header("laser"), start, 0.0, step, pause, 0.1, low, high, ranges, intensities)


def read(ros, message, *, text=True):
    codec, data = ros.codec(message.__msgtype__, text=text), ros.write(message)
    assert codec.kinds == ("lidar",)
    return codec.message("lidar", data, ORIGIN)


@every_distro
@pytest.mark.parametrize("big", [False, True])
def test_planar_scan(distro, big):
    """Rays without return, errors, and ranges beyond the sensor's limits are left out."""
    ros = Ros(distro, big=big)
    message = planar(ros, SCAN, floats(RANGES), floats(INTENSITIES))
    assert ros.codec(SCAN).probe(ros.write(message))[:2] == ("lidar", "laser")
    sweep = read(ros, message)
    assert (sweep.sensor, sweep.stamp_ns, sweep.log_ns, sweep.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    np.testing.assert_allclose(sweep.xyz, [[2, 0, 0], [0, 3, 0], [-4, 0, 0]], atol=1e-5)
    assert sweep.intensity.tolist() == [0, 1, 6]
    assert sweep.offset_ns.tolist() == [0, 1_000_000, 6_000_000]
    assert sweep.ring is None


def test_a_planar_scan_may_lack_intensities_times_and_limits():
    ros = Ros(Stores.ROS2_JAZZY)
    message = planar(ros, SCAN, floats([-1, 0, 100]), floats([]), start=np.pi, pause=0.0, low=0.0, high=0.0)
    sweep = read(ros, message, text=False)
    np.testing.assert_allclose(sweep.xyz, [[100, 0, 0]], atol=1e-4)
    assert sweep.intensity is None
    assert sweep.offset_ns is None


@pytest.mark.parametrize("step", [np.nan, np.inf])
def test_a_planar_scan_without_angles_has_no_points(step):
    ros = Ros(Stores.ROS2_JAZZY)
    assert len(read(ros, planar(ros, SCAN, floats([1, 2]), floats([]), start=np.nan, step=step)).xyz) == 0


def test_planar_scans_that_are_damaged():
    ros = Ros(Stores.ROS2_JAZZY)
    with pytest.raises(PointsError, match="scan has 2 ranges, but 3 intensities"):
        read(ros, planar(ros, SCAN, floats([1, 2]), floats([1, 2, 3])))
    data = ros.write(planar(ros, SCAN, floats([1, 2]), floats([])))
    with pytest.raises(DecodeError, match="payload ends early"):
        ros.codec(SCAN).message("lidar", data[:-5], ORIGIN)


def test_scans_that_are_too_large():
    """Each range grows tenfold while it is decoded, each packet thirtyfold."""
    ros, many = Ros(Stores.ROS2_JAZZY, VELODYNE), np.ones(200_001, np.float32)
    with pytest.raises(DecodeError, match="scan of 200001 rays, at most 200000"):
        read(ros, planar(ros, SCAN, many, floats([])))
    with pytest.raises(DecodeError, match="scan of 200001 rays, at most 200000"):
        read(ros, planar(ros, ECHOES, [ros.make(ECHO, many)], []))
    head = ros.write(velodyne_scan(ros, [], []))
    with pytest.raises(DecodeError, match="scan of 10001 packets, at most 10000"):
        ros.codec(NAME).message("lidar", memoryview(bytes(head[:-4]) + (10_001).to_bytes(4, "little")), ORIGIN)


@every_distro
def test_each_echo_is_a_point(distro):
    ros = Ros(distro)
    ranges = [ros.make(ECHO, floats(part)) for part in ([1, 2], [], [3])]
    strengths = [ros.make(ECHO, floats(part)) for part in ([10, 20], [], [30])]
    sweep = read(ros, planar(ros, ECHOES, ranges, strengths))
    np.testing.assert_allclose(sweep.xyz, [[1, 0, 0], [2, 0, 0], [-3, 0, 0]], atol=1e-5)
    assert sweep.intensity.tolist() == [10, 20, 30]
    assert sweep.offset_ns.tolist() == [0, 0, 2_000_000]


FOXGLOVE = {
    "foxglove_msgs/msg/LaserScan": (
        "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\nfloat64 start_angle\n"
        "float64 end_angle\nfloat64[] ranges\nfloat64[] intensities\n"
    )
}


def test_scan_of_foxglove_msgs_is_moved_by_its_pose():
    ros = Ros(Stores.ROS2_JAZZY, FOXGLOVE)
    point = ros.make("geometry_msgs/msg/Point", 1.0, 0.0, 5.0)
    pose = ros.make("geometry_msgs/msg/Pose", point, ros.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    ranges, strengths = np.array([2.0, 0.0, 3.0]), np.array([7.0, 8.0, 9.0])
    message = ros.make("foxglove_msgs/msg/LaserScan", ros.time(), "laser", pose, -HALF, HALF, ranges, strengths)
    sweep = read(ros, message)
    np.testing.assert_allclose(sweep.xyz, [[1, -2, 5], [1, 3, 5]], atol=1e-5)
    assert (sweep.stamp_ns, sweep.intensity.tolist()) == (STAMP_NS, [7, 9])
    assert ros.codec("foxglove_msgs/msg/LaserScan", text=False) is None  # generations differ: the log must say


def livox(driver):
    return {
        f"{driver}/msg/CustomPoint": (
            "# Livox costum pointcloud format.\n\nuint32 offset_time # offset time relative to the base time\n"
            "float32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
        ),
        f"{driver}/msg/CustomMsg": (
            "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3]  rsvd\n"
            f"{driver}/CustomPoint[] points\n"
        ),
    }


POINTS = [
    (0, 1.0, 2.0, 3.0, 100, 16, 0), (500, 0.0, 0.0, 0.0, 0, 0, 1), (1_000, -1.0, 0.5, 0.25, 200, 0, 5),
]  # fmt: skip


@every_distro
@pytest.mark.parametrize("driver", ["livox_ros_driver", "livox_ros_driver2"])
@pytest.mark.parametrize(
    ("timebase", "first"), [(STAMP_NS, 0), (STAMP_NS - 250, -250), (12_345, 0)], ids=["stamp", "near", "other clock"]
)
@pytest.mark.parametrize("text", [False, True])
def test_livox(distro, driver, timebase, first, text):
    """A point at the origin is a ray without return; `offset_time` counts from the time base."""
    ros = Ros(distro, livox(driver))
    points = [ros.make(f"{driver}/msg/CustomPoint", *point) for point in POINTS]
    message = ros.make(
        f"{driver}/msg/CustomMsg", ros.header("livox_frame"), timebase, 3, 1, np.zeros(3, np.uint8), points
    )
    data = ros.write(message)
    assert ros.codec(message.__msgtype__, text=text).probe(data)[:2] == ("lidar", "livox_frame")
    sweep = read(ros, message, text=text)
    np.testing.assert_array_equal(sweep.xyz, floats([[1, 2, 3], [-1, 0.5, 0.25]]))
    assert sweep.stamp_ns == STAMP_NS
    assert sweep.intensity.tolist() == [100, 200]
    assert sweep.ring.tolist() == [0, 5]
    assert sweep.offset_ns.tolist() == [first, first + 1_000]


def test_livox_without_points_or_cut_off():
    ros, name = Ros(Stores.ROS2_JAZZY, livox("livox_ros_driver2")), "livox_ros_driver2/msg/CustomMsg"
    empty = ros.make(name, ros.header(), STAMP_NS, 0, 1, np.zeros(3, np.uint8), [])
    assert read(ros, empty).xyz.shape == (0, 3)
    point = ros.make("livox_ros_driver2/msg/CustomPoint", *POINTS[0])
    data = ros.write(ros.make(name, ros.header(), STAMP_NS, 1, 1, np.zeros(3, np.uint8), [point] * 5))
    with pytest.raises(DecodeError, match="payload ends early"):
        ros.codec(name).message("lidar", data[:-20], ORIGIN)


VELODYNE = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
}
NAME = "velodyne_msgs/msg/VelodyneScan"


def velodyne_scan(ros, data, stamps):
    parts = [
        ros.make("velodyne_msgs/msg/VelodynePacket", ros.time(stamp), packet)
        for packet, stamp in zip(data, stamps, strict=True)
    ]
    return ros.make(NAME, ros.header("velodyne"), parts)


def small_messages(ros):
    """One message of each type, for the tests of damage."""
    echoes = [ros.make(ECHO, floats([1, 2]))]
    points = [ros.make("livox_ros_driver/msg/CustomPoint", *point) for point in POINTS]
    livox_parts = ros.header(), STAMP_NS, 3, 1, np.zeros(3, np.uint8), points
    return (
        planar(ros, SCAN, floats(RANGES), floats(INTENSITIES)), planar(ros, ECHOES, echoes, echoes),
        ros.make("livox_ros_driver/msg/CustomMsg", *livox_parts),
        velodyne_scan(ros, packets(0x22, STRONGEST, num=1), [STAMP]), *hesai_scans(ros, [hesai_packet()], [STAMP]),
    )  # fmt: skip


@every_distro
@pytest.mark.parametrize("text", [False, True])
def test_velodyne(distro, text):
    """The driver stamps a scan with the time of its last packet, so times of points are negative but for that one."""
    ros, data = Ros(distro, VELODYNE), packets(0x22, STRONGEST, num=3)
    stamps = [(STAMP[0], STAMP[1] - 2_654_000), (STAMP[0], STAMP[1] - 1_327_000), STAMP]
    message = velodyne_scan(ros, data, stamps)
    assert ros.codec(NAME, text=text).probe(ros.write(message))[:2] == ("lidar", "velodyne")
    sweep, points = read(ros, message, text=text), decode(data)
    assert sweep.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(sweep.xyz, points.xyz)
    np.testing.assert_array_equal(sweep.ring, points.ring)
    start_ns = np.array([-2_654_000, -1_327_000, 0])[points.packet]
    np.testing.assert_array_equal(sweep.offset_ns, np.rint(points.time_ns) + start_ns)
    assert sweep.offset_ns.min() == -2_654_000


def test_velodyne_packets_without_stamps_have_their_own_clock():
    ros, data = Ros(DISTROS[1], VELODYNE), packets(0x22, STRONGEST, num=3)
    offsets = read(ros, velodyne_scan(ros, data, [(0, 0)] * 3)).offset_ns
    assert offsets.min() == -2_654_000  # microseconds of the sensor


def test_velodynes_that_cant_be_read():
    ros = Ros(DISTROS[1], VELODYNE)
    with pytest.raises(PointsError, match="scan without packets"):
        read(ros, velodyne_scan(ros, [], []))
    with pytest.raises(UnsupportedError, match="no Velodyne that fbench can decode"):
        ros.codec(NAME).probe(ros.write(velodyne_scan(ros, np.zeros((1, SIZE), np.uint8), [STAMP])))
    cut = ros.write(velodyne_scan(ros, packets(0x22, STRONGEST), [STAMP] * 4))[:-100]
    with pytest.raises(DecodeError, match="payload ends early"):
        ros.codec(NAME).message("lidar", cut, ORIGIN)


HESAI = {
    "pandar_msgs/msg/PandarPacket": "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size\n",
    "pandar_msgs/msg/PandarScan": "std_msgs/Header header\npandar_msgs/PandarPacket[] packets\n",
    "nebula_msgs/msg/NebulaPacket": "builtin_interfaces/Time stamp\nuint8[] data\n",
    "nebula_msgs/msg/NebulaPackets": "std_msgs/Header header\nnebula_msgs/NebulaPacket[] packets\n",
}


def hesai_scans(ros, data, stamps):
    """The same packets as both messages have them."""
    pandar, nebula = [], []
    for packet, stamp in zip(data, stamps, strict=True):
        room = np.frombuffer(packet.ljust(1500, b"\0"), np.uint8)
        pandar.append(ros.make("pandar_msgs/msg/PandarPacket", ros.time(stamp), room, len(packet)))
        nebula.append(ros.make("nebula_msgs/msg/NebulaPacket", ros.time(stamp), np.frombuffer(packet, np.uint8)))
    return (
        ros.make("pandar_msgs/msg/PandarScan", ros.header("hesai"), pandar),
        ros.make("nebula_msgs/msg/NebulaPackets", ros.header("hesai"), nebula),
    )


@every_distro
@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("form", [0, 1])
def test_hesai(distro, text, form):
    """The driver stamps a scan with the time of its first packet."""
    ros = Ros(distro, HESAI)
    data = [hesai_packet([(7, 0, 1_000 + i, i + 1), (6, 3, 500, 9)]) for i in range(3)]
    stamps = [STAMP, (STAMP[0], STAMP[1] + 400_000), (STAMP[0], STAMP[1] + 800_000)]
    message = hesai_scans(ros, data, stamps)[form]
    name = message.__msgtype__
    assert ros.codec(name, text=text).probe(ros.write(message))[:2] == ("lidar", "hesai")
    sweep, points = read(ros, message, text=text), decode_hesai(read_table(data))
    assert sweep.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(sweep.xyz, points.xyz)
    assert sweep.intensity.tolist() == [9, 1, 9, 2, 9, 3]
    assert sweep.offset_ns.tolist() == [
        i * 400_000 + at for i in range(3) for at in (6_000 - 50_000 + 3 * 1_512, 6_000)
    ]


def test_hesai_scans_that_cant_be_read():
    ros = Ros(DISTROS[1], HESAI)
    for message in hesai_scans(ros, [], []):
        with pytest.raises(PointsError, match="scan without packets"):
            read(ros, message)
    for message in hesai_scans(ros, [bytes(861)], [STAMP]):
        with pytest.raises(UnsupportedError, match="of Hesai's only PandarXT-32 and XT-16"):
            ros.codec(message.__msgtype__).probe(ros.write(message))
    for message in hesai_scans(ros, [hesai_packet(stamp_us=us) for us in (5, 405)], [(0, 0)] * 2):
        assert read(ros, message).stamp_ns == STAMP_NS  # and the packets' own clock
    many = ros.write(hesai_scans(ros, [], [])[1])
    with pytest.raises(DecodeError, match="scan of 10001 packets, at most 10000"):
        read_nebula(memoryview(bytes(many[:-4]) + (10_001).to_bytes(4, "little")), "cdr")
