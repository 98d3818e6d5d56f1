"""Messages of LiDARs other than clouds: planar scans, Livox, and the packets of a turn of a Velodyne or Hesai."""

from typing import Any, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import DecodeError, PointsError
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.messages import PointCloud
from fbench.replay.logs.codecs import hesai, velodyne
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.packed_points import place
from fbench.replay.logs.codecs.planar import PlanarScan, find_valid, spread_rays
from fbench.replay.logs.codecs.ros.cursor import Cursor, Header, nanoseconds
from fbench.replay.logs.codecs.ros.decoder import get, stamp_ns

_MAX_RAYS = 200_000  # Of a turn; a thousand times less is usual
_MAX_PACKETS = 10_000  # Of a turn; a VLS-128 in dual mode sends 2,500 at its slowest


class _Rays(NamedTuple):
    """What LaserScan and MultiEchoLaserScan begin with."""

    header: Header
    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float


def read_rays(data: memoryview, encoding: str) -> PlanarScan:
    """Read a LaserScan. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    head, ranges, intensities = _read_head(cursor), cursor.floats(), cursor.floats()
    cursor.end()
    _require_few(len(ranges))
    return _planar(head, np.arange(len(ranges)), ranges, intensities)


def read_echoes(data: memoryview, encoding: str) -> PlanarScan:
    """Read a MultiEchoLaserScan: each echo becomes a point. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    head = _read_head(cursor)
    parts: list[list[Array]] = []
    for _ in range(2):
        num = cursor.uint32()
        _require_few(num)
        parts.append([cursor.floats() for _ in range(num)])
    cursor.end()
    _require_few(sum(map(len, parts[0])))
    ranges, intensities = (np.concatenate([np.zeros(0, np.float32), *part]) for part in parts)
    rays = np.repeat(np.arange(len(parts[0])), [len(echoes) for echoes in parts[0]])
    return _planar(head, rays, ranges, intensities)


def _require_few(num: int) -> None:
    if num > _MAX_RAYS:
        raise DecodeError(f"scan of {num} rays, at most {_MAX_RAYS} are read")


def _read_head(cursor: Cursor) -> _Rays:
    header, start, _, step, pause, _, low, high = cursor.header(), *(cursor.float32() for _ in range(7))
    return _Rays(header, start, step, pause, low, high)


def _planar(head: _Rays, rays: Array, ranges: Array, intensities: Array) -> PlanarScan:
    """Points of rays, given by number; an increment of 0 says that times aren't known."""
    angle = head.angle_min + head.angle_increment * rays.astype(np.float64)
    good = find_valid(ranges, head.range_min, head.range_max) & np.isfinite(angle)
    time_s = rays * head.time_increment if head.time_increment and np.isfinite(head.time_increment) else None
    return PlanarScan(head.header.frame_id, head.header.stamp_ns, angle, ranges, good, intensities, time_s)


def probe(scan: Any, encoding: str) -> Probe:
    """Tell the coordinate frame of a planar scan or of a Livox."""
    return Probe("lidar", scan.frame_id)


def planar_scan(kind: str, scan: PlanarScan, encoding: str, origin: Origin) -> PointCloud:
    """Return the points of a planar scan."""
    return scan.to_sweep(origin)


def probe_foxglove(message: Any, encoding: str) -> Probe:
    """Tell the coordinate frame of a LaserScan of foxglove_msgs."""
    return Probe("lidar", str(get(message, "frame_id")))


def foxglove_scan(kind: str, message: Any, encoding: str, origin: Origin) -> PointCloud:
    """Read a LaserScan of foxglove_msgs."""
    pose = get(message, "pose")
    where, turn = get(pose, "position"), get(pose, "orientation")
    angles = float(get(message, "start_angle")), float(get(message, "end_angle"))
    ranges, intensities = (np.array(get(message, name), np.float64).reshape(-1) for name in ("ranges", "intensities"))
    stamp = stamp_ns(get(message, "timestamp"), encoding)
    scan = spread_rays(str(get(message, "frame_id")), stamp, angles, ranges, intensities)
    translation, rotation = (
        np.array([get(part, axis) for axis in axes], np.float64) for part, axes in ((where, "xyz"), (turn, "xyzw"))
    )
    return place(scan.to_sweep(origin), translation, rotation)


class LivoxPoints(NamedTuple):
    """`CustomMsg` of the drivers of Livox."""

    frame_id: str
    stamp_ns: int
    timebase_ns: int
    points: Array


_LIVOX = np.dtype(
    [
        ("offset_time", "u4"),
        ("x", "f4"),
        ("y", "f4"),
        ("z", "f4"),
        ("reflectivity", "u1"),
        ("tag", "u1"),
        ("line", "u1"),
    ]
)
_SAME_CLOCK_NS = 1_000_000_000


def read_livox(data: memoryview, encoding: str) -> LivoxPoints:
    """Read a CustomMsg. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    header, timebase_ns = cursor.header(), cursor.uint64()
    cursor.uint32()  # number of points, which their sequence says again
    for _ in range(4):
        cursor.uint8()  # number of the LiDAR, three reserved
    points = cursor.rows(_LIVOX, cursor.uint32())
    cursor.end()
    return LivoxPoints(header.frame_id, header.stamp_ns, timebase_ns, points)


def livox_sweep(kind: str, message: LivoxPoints, encoding: str, origin: Origin) -> PointCloud:
    """Return the points of a CustomMsg, without those at the origin: rays without return. Their times count from
    `timebase`, which is the stamp unless the sensor's clock is another one; then they count from the stamp.
    """
    xyz = np.stack([message.points[axis] for axis in "xyz"], axis=1).astype(np.float32)
    good = xyz.any(axis=1)
    points, start_ns = message.points[good], message.timebase_ns - message.stamp_ns
    ns = points["offset_time"].astype(np.int64) + (start_ns if abs(start_ns) <= _SAME_CLOCK_NS else 0)
    fits = not len(ns) or max(int(ns.max()), -int(ns.min())) < 2**31
    return PointCloud(
        origin.sensor, message.stamp_ns, origin.log_ns, xyz[good], points["reflectivity"].astype(np.float32),
        points["line"].astype(np.uint16), ns.astype(np.int32) if fits else None, origin.frame_number,
    )  # fmt: skip


class VelodyneScan(NamedTuple):
    """`velodyne_msgs/VelodyneScan`."""

    header: Header
    stamps_ns: tuple[int, ...]  # Of the packets
    packets: Array  # (N, 1206) bytes


_PACKET = np.dtype([("sec", "u4"), ("nanosec", "u4"), ("data", "u1", (velodyne.SIZE,))])


def read_velodyne(data: memoryview, encoding: str) -> VelodyneScan:
    """Read a VelodyneScan. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    header, num = cursor.header(), _require_packets(cursor.uint32())
    rows = cursor.rows(_PACKET, num)
    cursor.end()
    stamps = (nanoseconds(int(sec), int(nanosec)) for sec, nanosec in zip(rows["sec"], rows["nanosec"], strict=True))
    return VelodyneScan(header, tuple(stamps), np.ascontiguousarray(rows["data"]))


def _require_packets(num: int) -> int:
    if num > _MAX_PACKETS:
        raise DecodeError(f"scan of {num} packets, at most {_MAX_PACKETS} are read")
    return num


def probe_velodyne(scan: VelodyneScan, encoding: str) -> Probe:
    """Tell the coordinate frame. Raises UnsupportedError where the model can't be decoded."""
    velodyne.find_model(scan.packets)
    return Probe("lidar", scan.header.frame_id)


def velodyne_sweep(kind: str, scan: VelodyneScan, encoding: str, origin: Origin) -> PointCloud:
    """Return the points of all packets; times count from the header's stamp, which the driver takes from the last
    packet unless it is told to take the first.
    """
    if not len(scan.packets):
        raise PointsError("scan without packets")
    points = velodyne.decode(scan.packets)
    packet_ns = np.array(scan.stamps_ns, np.int64) - scan.header.stamp_ns
    if not all(scan.stamps_ns):  # written by a program that leaves the packets' own stamps out
        packet_ns = velodyne.clock_ns(scan.packets)
    return _join_packets(points, packet_ns, scan.header, origin)


def _join_packets(points: velodyne.Points, packet_ns: Int64, header: Header, origin: Origin) -> PointCloud:
    """Return the points of packets whose stamps are so long after the header's."""
    ns = np.rint(points.time_ns).astype(np.int64) + packet_ns[points.packet]
    fits = not len(ns) or max(int(ns.max()), -int(ns.min())) < 2**31
    return PointCloud(
        origin.sensor, header.stamp_ns, origin.log_ns, points.xyz, points.intensity, points.ring,
        ns.astype(np.int32) if fits else None, origin.frame_number,
    )  # fmt: skip


class HesaiScan(NamedTuple):
    """`PandarScan` of Hesai's driver and of pandar_msgs, and `nebula_msgs/NebulaPackets`."""

    header: Header
    stamps_ns: tuple[int, ...]  # Of the packets
    packets: tuple[bytes, ...]


_PANDAR = np.dtype([("sec", "u4"), ("nanosec", "u4"), ("data", "u1", (1500,)), ("size", "u4")])


def read_pandar(data: memoryview, encoding: str) -> HesaiScan:
    """Read a PandarScan, whose packets have room for 1500 bytes. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    header, num = cursor.header(), _require_packets(cursor.uint32())
    rows = cursor.rows(_PANDAR, num)
    cursor.end()
    stamps = tuple(nanoseconds(int(row["sec"]), int(row["nanosec"])) for row in rows)
    return HesaiScan(header, stamps, tuple(bytes(row["data"][: row["size"]]) for row in rows))


def read_nebula(data: memoryview, encoding: str) -> HesaiScan:
    """Read NebulaPackets. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    header, num = cursor.header(), _require_packets(cursor.uint32())
    parts = [(nanoseconds(cursor.uint32(), cursor.uint32()), bytes(cursor.blob())) for _ in range(num)]
    cursor.end()
    return HesaiScan(header, tuple(stamp for stamp, _ in parts), tuple(packet for _, packet in parts))


def probe_hesai(scan: HesaiScan, encoding: str) -> Probe:
    """Tell the coordinate frame. Raises UnsupportedError where the model can't be decoded."""
    hesai.read_table(scan.packets)
    return Probe("lidar", scan.header.frame_id)


def hesai_sweep(kind: str, scan: HesaiScan, encoding: str, origin: Origin) -> PointCloud:
    """Return the points of all packets; times count from the header's stamp, which drivers take from the first one."""
    if not scan.packets:
        raise PointsError("scan without packets")
    table = hesai.read_table(scan.packets)
    packet_ns = np.array(scan.stamps_ns, np.int64) - scan.header.stamp_ns
    if not all(scan.stamps_ns) or len(packet_ns) != len(table):
        packet_ns = hesai.clock_ns(table)
    return _join_packets(hesai.decode(table), packet_ns, scan.header, origin)
