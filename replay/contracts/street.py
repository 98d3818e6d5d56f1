"""A street in memory on which conditions are tried: a camera, a LiDAR and a radar at 10 Hz, and three cars as truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.conditions import ChangesTimes, Condition, Level, Measurement, Part, Site, needs_of
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, LogSpan, Mount, Rig

PERIOD_NS = 100_000_000
_FIRST_NS = 1_700_000_000_000_000_000
_UPRIGHT, _FORWARD = np.array([0.0, 0, 0, 1]), np.array([-0.5, 0.5, -0.5, 0.5])
_SIZE_WH = (160, 120)
_CARS = np.array([[12.0, -2.0], [25.0, 3.0], [45.0, -3.0]])  # x and y of their middles at the beginning [m]
_LWH = np.array([4.4, 1.8, 1.5])
_WALL_M, _LIDAR_M = 70.0, 1.8


def _rig() -> Rig:
    model = CameraModel(np.array([[120.0, 0, 79.5], [0, 120.0, 59.5], [0, 0, 1]]), _SIZE_WH)
    mounts = {
        "camera": Mount("camera", np.array([1.5, 0, 1.5]), _FORWARD),
        "lidar": Mount("lidar", np.array([1.0, 0, _LIDAR_M]), _UPRIGHT),
        "radar": Mount("radar", np.array([3.0, 0, 0.6]), _UPRIGHT),
    }
    return Rig(mounts, {"camera": model})


@dataclass(frozen=True, eq=False)
class Street:
    """A log of so many instants; implements `fbench.replay.contracts.protocols.Reader`."""

    num: int = 12
    rig: Rig = field(default_factory=_rig)
    info: LogInfo = field(default_factory=lambda: LogInfo("street", "street-1"))
    poses: tuple[str, ...] = ()

    @property
    def span(self) -> LogSpan:
        """When messages are recorded."""
        last_ns = _FIRST_NS + (self.num - 1) * PERIOD_NS
        return LogSpan(_FIRST_NS, last_ns, dict.fromkeys(self.rig.mounts, PERIOD_NS))

    @property
    def num_messages(self) -> Mapping[str, int]:
        """As many of each sensor."""
        return dict.fromkeys(self.rig.mounts, self.num)

    def messages(self) -> Iterator[Message]:
        """A cloud, an image and a scan of each instant."""
        for index in range(self.num):
            stamp_ns = _FIRST_NS + index * PERIOD_NS
            yield _cloud(index, stamp_ns)
            yield _image(index, stamp_ns)
            yield _scan(index, stamp_ns)

    def events(self) -> Iterator[Message]:
        """The same."""
        return self.messages()

    def truths(self) -> Iterator[Truth]:
        """The cars."""
        for index in range(self.num):
            stamp_ns, centers = _FIRST_NS + index * PERIOD_NS, _centers(index)
            labels, ids = np.array(["car"] * len(centers)), np.arange(len(centers))
            boxes = Boxes3D(
                centers, np.tile(_LWH, (len(centers), 1)), np.zeros(len(centers)), label=labels, track_id=ids
            )
            yield Truth(stamp_ns, stamp_ns, boxes)


def _centers(index: int) -> Float64:
    """The middles of the cars (3, 3) [m] in body coordinates; they drive ahead at 5 m/s."""
    return np.column_stack([_CARS[:, 0] + 0.5 * index, _CARS[:, 1], np.full(len(_CARS), _LWH[2] / 2)])


def _ranges(origin: Float64, directions: Float64, index: int) -> Float64:
    """How far rays (N, 3) go until ground, a round wall, or a car [m]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
        nearest = np.minimum(ground, _WALL_M)
        for center in _centers(index):
            near, far = ((center + side * _LWH / 2 - origin) / directions for side in (-1, 1))
            enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
            nearest = np.where((enter > 0) & (enter <= leave), np.minimum(nearest, enter), nearest)
    return nearest


@lru_cache(64)
def _cloud(index: int, stamp_ns: int) -> PointCloud:
    ring, azimuth = (a.ravel() for a in np.meshgrid(np.arange(16), np.radians(np.arange(-180, 180, 2.0))))
    altitude = np.radians(-15 + 1.25 * ring)
    flat = np.cos(altitude)
    directions = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)])
    range_m = _ranges(np.array([1.0, 0, _LIDAR_M]), directions, index)
    offset_ns = ((azimuth / (2 * np.pi) + 0.5) * PERIOD_NS * 0.9).astype(np.int32)
    intensity = (40 + 5 * ring + 20 * np.cos(3 * azimuth)).astype(np.float32)
    xyz = (directions * range_m[:, None]).astype(np.float32)
    return PointCloud("lidar", stamp_ns, stamp_ns, xyz, intensity, ring.astype(np.uint16), offset_ns, index)


@lru_cache(64)
def _image(index: int, stamp_ns: int) -> Image:
    width, height = _SIZE_WH
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    texture = 30 * np.sin(u / 3 + index) * np.cos(v / 5)
    gray = np.where(v < height // 2, 200 - v / 2, 70 + v / 4 + texture)
    gray = np.where((np.abs(u - 80) < 25) & (np.abs(v - 65) < 12), 20 + texture / 3, gray)
    pixels = np.clip(np.stack([gray + 15, gray, gray - 10], axis=2), 0, 255).astype(np.uint8)
    return Image("camera", stamp_ns, stamp_ns, pixels.tobytes(), "bgr8", _SIZE_WH, index)


@lru_cache(64)
def _scan(index: int, stamp_ns: int) -> RadarScan:
    azimuth = np.radians(np.linspace(-60, 60, 61))
    directions = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))])
    range_m = _ranges(np.array([3.0, 0, 0.6]), directions, index)
    far, bearing, level = (a.astype(np.float32) for a in (range_m, azimuth, np.zeros(len(azimuth))))
    velocity = (5.0 * np.cos(azimuth) * (range_m < _WALL_M)).astype(np.float32)
    rcs = (np.where(range_m < _WALL_M, 12.0, -4.0) + 6 * np.sin(9 * azimuth)).astype(np.float32)
    xyz = (directions * range_m[:, None]).astype(np.float32)
    return RadarScan("radar", stamp_ns, stamp_ns, xyz, velocity, rcs, far, bearing, level, index)


@dataclass(frozen=True, eq=False)
class Call:
    """A message with its place, as conditions get them."""

    message: Measurement
    site: Site

    def with_seed(self, seed: int) -> "Call":
        """Return the same with other random numbers."""
        return replace(self, site=replace(self.site, key=(seed, *self.site.key[1:])))

    def disturb(self, condition: Condition, level: Level) -> tuple[Measurement, ...]:
        """Return what becomes of the message."""
        return tuple(condition.disturb(self.message, level, self.site))


class _Probe:
    """Notes what a condition would be given."""

    def __init__(self, condition: Condition) -> None:
        self.version, self.kinds, self.levels = condition.version, condition.kinds, condition.levels
        self.needs = needs_of(condition)
        self.changes_times = isinstance(condition, ChangesTimes) and condition.changes_times
        self.calls: list[Call] = []

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        self.calls.append(Call(message, site))
        return (message,)


def list_calls(condition: Condition, street: Street, severity: int) -> list[Call]:
    """Return what a condition is given on a street, in the order of the log. Raises LogError where it needs what the
    street lacks.
    """
    probe = _Probe(condition)
    part = Part("checked", probe, str(severity))  # type: ignore[arg-type]  # its attributes aren't its class's
    log = DisturbedReader(street, Disturbance((part,), span=street.span), Effects())
    for _ in log.messages():
        pass
    return probe.calls
