"""Samples that a preview is drawn from, and edges of depth and brightness in them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Array, Float32, Float64, Int64
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Kind, LogInfo, Rig
from fbench.replay.geometry.transforms import inverse, transform
from fbench.replay.logs.codecs.packed_points import take_points

_SPREAD_RAD = (np.radians(0.8), np.radians(0.25))  # How far a neighbor is away at most, in azimuth and altitude
_STEPS, _MAX_SPREAD_RAD = 1.25, np.radians(2.5)
"""A LiDAR whose shots lie farther apart in azimuth has its neighbors within so many steps."""
_NEIGHBORS = 8
_MAX_ALIKE = 64  # Points of one direction that may be each other's neighbors; sensors give two or three returns
_MIN_STEP = 0.06
_MAX_RANGE_M = 60.0
_COLUMN_RAD, _RINGS_RAD = np.radians(0.5), (np.radians(0.1), np.radians(3.0))
"""Width of upright columns of points, and how far apart in altitude the rings of neighbors in a column are."""
_MIN_RISE_M = 0.4  # Between two rings on the ground is a jump of depth, too, but no edge
Direction = Literal["upright", "level"]  # Of edges
MAX_POINTS, MAX_ECHOES = 400_000, 20_000
"""So many points of a LiDAR and echoes of a radar are drawn and judged at most; of more, every n-th."""


def depth_edges(xyz: Array) -> Array:
    """Rows of the points (N, 3) [m], in coordinates of the sensor, behind which a neighbor in azimuth is over a meter
    and over 6 % farther away: the near side of an edge, which the image shows too.

    After J. Levinson and S. Thrun, "Automatic Online Calibration of Cameras and Lasers", RSS 2013.
    """
    p = np.asarray(xyz, np.float64)
    distance = np.sqrt(np.sum(p**2, axis=1))
    rows = np.flatnonzero((distance > 1.0) & (distance < 3 * _MAX_RANGE_M))
    if len(rows) < _NEIGHBORS + 1:
        return np.zeros(0, np.int64)
    p, distance = p[rows], distance[rows]
    angles = np.stack([np.arctan2(p[:, 1], p[:, 0]), np.arcsin(np.clip(p[:, 2] / distance, -1, 1))], axis=1)
    if len(few := _first_of_each(angles)) < len(rows):
        rows, distance, angles = rows[few], distance[few], angles[few]
    scaled = angles / (_spread_rad(angles), _SPREAD_RAD[1])
    _, near = cKDTree(scaled).query(scaled, k=_NEIGHBORS + 1, distance_upper_bound=1.0)
    far = np.append(distance, 0.0)[near].max(axis=1)  # the last row stands for no neighbor
    is_edge = (far - distance > np.maximum(1.0, _MIN_STEP * distance)) & (distance < _MAX_RANGE_M)
    return np.asarray(rows[is_edge], np.int64)


def _first_of_each(angles: Float64) -> Int64:
    """Rows of the first `_MAX_ALIKE` points of each direction (N, 2): trees of neighbors can't part equal ones."""
    same = np.unique(np.ascontiguousarray(angles).view(np.complex128).ravel(), return_inverse=True)[1]
    order = np.argsort(same, kind="stable")
    first = np.flatnonzero(np.diff(same[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    return np.sort(order[rank < _MAX_ALIKE]).astype(np.int64)


def _spread_rad(angles: Float64) -> float:
    """How far neighbors in azimuth may be apart, from azimuth and altitude (N, 2) of all points.

    A turn of few shots over many rings has steps of a degree: then no shot has any other within the usual spread.
    """
    aligned = angles / (_MAX_SPREAD_RAD, _SPREAD_RAD[1] / 4)  # of one ring
    near, _ = cKDTree(aligned).query(aligned, k=2, distance_upper_bound=1.0)
    steps = np.asarray(near, np.float64)[:, 1]
    found = steps[np.isfinite(steps)] * _MAX_SPREAD_RAD
    step = float(np.median(found)) if len(found) else 0.0
    return float(min(max(_SPREAD_RAD[0], _STEPS * step), _MAX_SPREAD_RAD))


def level_edges(xyz: Array) -> Float64:
    """Points (M, 3) [m] on upper edges of what points (N, 3) show, in coordinates of the sensor: half way in altitude
    between one on the near side and its neighbor above, which is as much farther away as for `depth_edges` and not on
    the same ground. Rings are degrees apart, and no point lies on the edge itself.
    """
    p = np.asarray(xyz, np.float64)
    distance = np.sqrt(np.sum(p**2, axis=1))
    rows = np.flatnonzero((distance > 1.0) & (distance < 3 * _MAX_RANGE_M))
    azimuth = np.arctan2(p[rows, 1], p[rows, 0])
    altitude = np.arcsin(np.clip(p[rows, 2] / distance[rows], -1, 1))
    column = np.floor(azimuth / _COLUMN_RAD).astype(np.int64)
    order = np.lexsort((distance[rows], altitude, column))
    p, azimuth, altitude, column, distance = (a[order] for a in (p[rows], azimuth, altitude, column, distance[rows]))
    rise, step, near = np.diff(altitude), np.diff(distance), distance[:-1]
    is_edge = (np.diff(column) == 0) & (rise > _RINGS_RAD[0]) & (rise < _RINGS_RAD[1]) & (near < _MAX_RANGE_M)
    is_edge &= (step > np.maximum(1.0, _MIN_STEP * near)) & (np.abs(np.diff(p[:, 2])) > _MIN_RISE_M)
    i = np.flatnonzero(is_edge)
    middle = (altitude[i] + altitude[i + 1]) / 2
    flat = np.cos(middle)
    ahead = np.stack([flat * np.cos(azimuth[i]), flat * np.sin(azimuth[i]), np.sin(middle)], axis=1)
    return np.asarray(near[i, None] * ahead, np.float64)


def edge_strength(pixels: Pixels, width: int, direction: Direction = "upright") -> Float32:
    """How near to an edge of brightness in one direction each pixel is, 0 to 1, of an image scaled to `width` (H, W).

    Upright ones go with jumps of depth between neighbors in azimuth, level ones with those in altitude; others would
    only hide them. Edges spread some pixels, so that a calibration that is almost right is better than one that is far
    off.
    """
    import cv2

    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    gray = cv2.cvtColor(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 1.0)
    strength = np.abs(cv2.Sobel(smooth, cv2.CV_32F, *((1, 0) if direction == "upright" else (0, 1))))
    top = max(float(np.quantile(strength, 0.95)), 1e-3)
    sharp = np.minimum(strength / top, 1).astype(np.float32)
    wide = [cv2.GaussianBlur(sharp, (0, 0), sigma) for sigma in (1.5, 4.0)]
    return np.asarray((sharp + wide[0] + wide[1]) / 3, np.float32)


def sample_image(field: Float32, uv: Float64) -> Float64:
    """Values of a field (H, W) at the pixels (N, 2) nearest to `uv`; its mean where they are outside."""
    height, width = field.shape
    inside = (uv[:, 0] >= -0.5) & (uv[:, 0] < width - 0.5) & (uv[:, 1] >= -0.5) & (uv[:, 1] < height - 0.5)
    values = np.full(len(uv), float(field.mean(dtype=np.float64)))
    at = np.round(uv[inside]).astype(np.int64)
    values[inside] = field[at[:, 1], at[:, 0]]
    return values


@dataclass(frozen=True, eq=False)
class Points:
    """Points of one LiDAR or radar."""

    sensor: str
    kind: Kind
    xyz: Float64  # (N, 3) in body coordinates [m], or in the sensor's own where its place isn't known
    speed_mps: Float64  # (N,) radial velocity, positive receding; NaN where it isn't measured
    is_placed: bool = True


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame that is drawn."""

    frame: Frame
    rig: Rig  # Sensors whose place is known, and cameras that are calibrated
    truth: Truth | None = None
    ego_mps: float | None = None
    """How fast the poses of the log say that the body drives forward [m/s]; negative: backwards."""

    @cached_property
    def cameras(self) -> Sequence[str]:
        """Cameras whose image can be decoded, sorted."""
        images = [n for n, m in sorted(self.frame.messages.items()) if isinstance(m, Image)]
        return [name for name in images if self._decode(name) is not None]

    def image(self, camera: str) -> Pixels:
        """Image (H, W, 3) BGR, decoded anew, since all take much memory. Raises DecodeError where it isn't there."""
        pixels = self._decode(camera)
        if pixels is None:
            raise DecodeError(f"frame {self.frame.index} has no image of '{camera}'")
        return pixels

    def _decode(self, camera: str) -> Pixels | None:
        message = self.frame.messages.get(camera)
        return decode(message) if isinstance(message, Image) else None

    @cached_property
    def points(self) -> Sequence[Points]:
        """Points of all LiDARs and radars, by name of the sensor."""
        found = []
        for _, message in sorted(self.frame.messages.items()):
            if isinstance(message, PointCloud | RadarScan):
                xyz, is_placed = np.asarray(message.xyz, np.float64), message.sensor in self.rig.mounts
                if is_placed:
                    xyz = transform(self.rig.body_T_sensor(message.sensor), xyz)
                measured = message.radial_velocity_mps if isinstance(message, RadarScan) else None
                speed = np.full(len(xyz), np.nan) if measured is None else np.asarray(measured, np.float64)
                kind: Kind = "lidar" if isinstance(message, PointCloud) else "radar"
                found.append(Points(message.sensor, kind, xyz, speed, is_placed))
        return found

    @cached_property
    def depth_edges_m(self) -> Float64:
        """Near sides (N, 3) of jumps in depth of all placed LiDARs, in body coordinates [m]."""
        return self._edges_m(lambda xyz: np.asarray(xyz[depth_edges(xyz)], np.float64))

    @cached_property
    def level_edges_m(self) -> Float64:
        """Upper edges (N, 3) that all placed LiDARs show, in body coordinates [m]."""
        return self._edges_m(level_edges)

    def _edges_m(self, find: Callable[[Float64], Float64]) -> Float64:
        """Edges that are found in coordinates of each sensor, along its rings."""
        found = [np.zeros((0, 3))]
        for points in self.points_of("lidar"):
            body_T_sensor = self.rig.body_T_sensor(points.sensor)
            found.append(transform(body_T_sensor, find(transform(inverse(body_T_sensor), points.xyz))))
        return np.concatenate(found)

    def points_of(self, kind: Kind) -> list[Points]:
        """Points in body coordinates of the sensors of one kind."""
        return [points for points in self.points if points.kind == kind and points.is_placed]

    def age_ms(self, sensor: str) -> float | None:
        """How much later than the frame's instant a sensor measured [ms]; `None` where it is missing."""
        message = self.frame.messages.get(sensor)
        return None if message is None else (message.stamp_ns - self.frame.stamp_ns) / 1e6


def thin(frame: Frame) -> tuple[Frame, dict[str, int]]:
    """Return a frame with at most `MAX_POINTS` or `MAX_ECHOES` of each sensor, and every how many-th of its points are
    left, by the sensors that had more.
    """
    messages, strides = dict(frame.messages), dict[str, int]()
    for name, message in frame.messages.items():
        if isinstance(message, PointCloud | RadarScan):
            stride = -(-len(message.xyz) // (MAX_POINTS if isinstance(message, PointCloud) else MAX_ECHOES))
            if stride > 1:
                messages[name], strides[name] = take_points(message, np.arange(0, len(message.xyz), stride)), stride
    return (replace(frame, messages=messages) if strides else frame), strides


@dataclass(frozen=True)
class Instant:
    """The stamps of what is in one frame."""

    index: int
    stamp_ns: int
    stamps_ns: Mapping[str, int]  # By sensor; missing ones aren't there


@dataclass(frozen=True, eq=False)
class Material:
    """What was read of a log."""

    info: LogInfo
    kinds: Mapping[str, Kind]  # All sensors, by name
    rig: Rig  # As the log begins, without sensors whose place isn't known
    problems: Mapping[str, str]  # What is unknown of the calibration of a sensor, by its name
    reference: str
    samples: Sequence[Sample]  # Frames that are drawn
    kept: Sequence[Sample]  # These and more frames, which are measured but not drawn
    num_frames: int
    num_labeled: int
    instants: Sequence[Instant]  # Of frames evenly spread over the log
    arrivals: Mapping[str, Sequence[tuple[int, int]]]
    """`stamp_ns` and `log_ns` of messages evenly spread over the log, by sensor or stream of poses."""
    num_messages: Mapping[str, int]  # Read of each sensor or stream of poses
    missing: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """In how many frames a sensor is missing, by its name and the reason."""
    periods_mps: Mapping[str, float] = field(default_factory=dict)
    """With what period radial velocities alias, by radar, where the log says so [m/s]."""
    strides: Mapping[str, int] = field(default_factory=dict)
    """Every how many-th point is looked at, by sensor with more than `MAX_POINTS` or `MAX_ECHOES`."""
    effects: Mapping[str, str] = field(default_factory=dict)
    """What conditions changed, by sensor, in words."""
