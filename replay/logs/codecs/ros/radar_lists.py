"""Lists of radar detections or objects in the messages of many drivers: returns with radial velocity.

Types that are known by name come first. Of others the fields decide: lists whose parts have a position and a relative
velocity, in the words that drivers of Continental radars use.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.messages import RadarScan
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.ros.cursor import Header
from fbench.replay.logs.codecs.ros.decoder import find, get, header
from fbench.replay.logs.codecs.ros.definitions import Types

if TYPE_CHECKING:
    from rosbags.interfaces import Nodetype

Row = tuple[float, ...]


@dataclass(frozen=True)
class Polar:
    """Names of the fields of a return in polar coordinates."""

    range: str
    azimuth: str
    rate: str
    rcs: str = ""
    elevation: str = ""
    unit_rad: float = 1.0  # Of the azimuth; negative where it counts to the right
    part: str = ""  # Field of the list's parts that holds the others
    invalid: tuple[str, ...] = ()  # Fields that are true where a value isn't one


@dataclass(frozen=True)
class RadarList:
    """Where a message has its returns."""

    parts: str  # Field with the list
    polar: Polar | None = None
    names: tuple[str, str, str, str] | None = None  # Fields with x, y, and relative velocity along them
    vectors: tuple[str, str] | None = None  # Fields with position and relative velocity, as points or poses
    rcs: str = ""


_ARS548 = Polar(
    "range", "azimuth_angle", "range_rate", "rcs", "elevation_angle",
    invalid=("invalid_distance", "invalid_azimuth", "invalid_elevation", "invalid_range_rate"),
)  # fmt: skip
_SRR520 = Polar("range", "azimuth_angle", "range_rate", "rcs")
_BOSCH = Polar("radial_distance", "azimuth_angle", "radial_velocity", "reflected_power", part="a")
KNOWN: Mapping[str, RadarList] = {
    "continental_msgs/msg/ContinentalArs548DetectionList": RadarList("detections", _ARS548),
    "continental_msgs/msg/ContinentalSrr520DetectionList": RadarList("detections", _SRR520),
    "off_highway_general_purpose_radar_msgs/msg/Targets": RadarList("targets", _BOSCH),
    "radar_msgs/msg/RadarDetectionArray": RadarList("detections", vectors=("position", "velocity"), rcs="amplitude"),
}
"""By full name of the type. Azimuths count to the left, as REP 103 has it."""

_HINT = re.compile(rb"vrel|relative_vel|longitude_vel", re.IGNORECASE)
_COLUMNS = (
    ("distx", "disty", "vrelx", "vrely"), ("distlong", "distlat", "vrellong", "vrellat"),
    ("longitudedist", "lateraldist", "longitudevel", "lateralvel"),
)  # fmt: skip
"""Position and relative velocity in the words of ARS 408 and of Apollo, without underscores and what they belong to."""
_OWNER = re.compile(r"^(object|cluster|target|obj|track)(?=.)")
_POSITIONS, _VELOCITIES = ("position", "pose"), ("relativevelocity",)


def may_be_list(definition: bytes) -> bool:
    """Tell whether a definition speaks of relative velocities, so that it is worth parsing."""
    return _HINT.search(definition) is not None


def recognize(name: str, types: Types) -> RadarList | None:
    """Find the returns in a type of messages by its fields; `None` where it has none."""
    for field, descriptor in types[name][1]:
        fields = _fields_of_parts(descriptor, types)
        plain = {re.sub("_", "", _OWNER.sub("", part.lower())): part for part in reversed(fields)}
        rcs = plain.get("rcs", "")
        for columns in _COLUMNS:
            if all(column in plain for column in columns):
                x, y, vx, vy = (plain[column] for column in columns)
                return RadarList(field, names=(x, y, vx, vy), rcs=rcs)
        position, velocity = (next((plain[n] for n in names if n in plain), "") for names in (_POSITIONS, _VELOCITIES))
        if position and velocity:
            return RadarList(field, vectors=(position, velocity), rcs=rcs)
    return None


def _fields_of_parts(descriptor: tuple["Nodetype", Any], types: Types) -> list[str]:
    """Fields of the messages in a sequence; none of anything else."""
    from rosbags.interfaces import Nodetype

    node, what = descriptor
    if node != Nodetype.SEQUENCE or what[0][0] != Nodetype.NAME:
        return []
    return [field for field, _ in types[what[0][1]][1]]


def probe(message: Any, encoding: str) -> Probe:
    """Tell the coordinate frame, where the message names one."""
    return Probe("radar", _header(message, encoding).frame_id)


def make_reader(layout: RadarList) -> Callable[[str, Any, str, Origin], RadarScan]:
    """Return a function that reads messages with this list."""

    def read(kind: str, message: Any, encoding: str, origin: Origin) -> RadarScan:
        parts, stamp_ns = get(message, layout.parts), _header(message, encoding).stamp_ns
        if layout.polar is not None:
            return polar_scan(parts, layout.polar, stamp_ns, origin)
        place, velocity = _cartesian(parts, layout)
        rcs = None if not layout.rcs else np.array([float(get(part, layout.rcs)) for part in parts], np.float32)
        distance = np.linalg.norm(place, axis=1)
        rate = (place * velocity).sum(axis=1) / distance  # NaN at the sensor itself
        xyz, radial = place.astype(np.float32), rate.astype(np.float32)
        return RadarScan(origin.sensor, stamp_ns, origin.log_ns, xyz, radial, rcs, frame_number=origin.frame_number)

    return read


def _cartesian(parts: Sequence[Any], layout: RadarList) -> tuple[Float64, Float64]:
    """Positions and relative velocities (N, 3)."""
    if layout.names is not None:
        table = np.array([[float(get(part, n)) for n in layout.names] for part in parts], np.float64).reshape(-1, 4)
        flat = np.zeros((len(table), 1))
        return np.hstack([table[:, :2], flat]), np.hstack([table[:, 2:], flat])
    position, velocity = layout.vectors or ("", "")
    return _vectors([get(part, position) for part in parts]), _vectors([get(part, velocity) for part in parts])


def _vectors(parts: Sequence[Any]) -> Float64:
    """Vectors (N, 3) of points, or of the poses and twists that hold them."""
    rows = [[float(get(_vector(part), axis)) for axis in "xyz"] for part in parts]
    return np.array(rows, np.float64).reshape(-1, 3)


def _vector(part: Any) -> Any:
    for _ in range(2):  # PoseWithCovariance has a Pose, which has a Point
        inner = find(part, "pose", "twist", "position", "linear")
        part = part if inner is None else inner
    inner = find(part, "position", "linear")
    return part if inner is None else inner


def polar_scan(parts: Sequence[Any], polar: Polar, stamp_ns: int, origin: Origin) -> RadarScan:
    """Make a scan of returns in polar coordinates, without those that the sensor says are none."""
    inner = [get(part, polar.part) for part in parts] if polar.part else parts
    good = [part for part in inner if not any(find(part, name) for name in polar.invalid)]
    names = (polar.range, polar.azimuth, polar.rate, polar.rcs, polar.elevation)
    columns: list[Float64 | None] = [
        np.array([float(get(part, name)) for part in good], np.float64) if name else None for name in names
    ]
    distance, turn, rate, rcs, elevation = columns
    if distance is None or turn is None or rate is None:
        raise DecodeError("returns without range, azimuth or range rate")
    azimuth = turn * polar.unit_rad
    up = np.zeros(len(good)) if elevation is None else elevation
    flat = distance * np.cos(up)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(up)], axis=1)
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz.astype(np.float32), _float32(rate), _float32(rcs),
        _float32(distance), _float32(azimuth), _float32(elevation), origin.frame_number,
    )  # fmt: skip


def _float32(column: Float64 | None) -> Float32 | None:
    return None if column is None else column.astype(np.float32)


def _header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame; some lists have neither."""
    return Header(0, "") if find(message, "header") is None else header(message, encoding)
