"""Importer of RADIATE: a spinning Navtech radar, an HDL-32E LiDAR, a ZED stereo camera, GPS and IMU.

A file has 18 lines (README of the SDK): latitude, longitude [deg] and altitude [m]; a covariance (3 lines); the IMU's
quaternion x, y, z, w; turn rates; accelerations; covariances (9 lines); velocity; turn rates. The README doesn't say
whose axes these are. In the sequence that came with the SDK the velocity is north, east, down: that is how positions
move.

M. Sheeny, E. De Pellegrin, S. Mukherjee, A. Ahrabian, S. Wang and A. Wallace, "RADIATE: A Radar Dataset for Automotive
Perception in Bad Weather", ICRA 2021.
"""

import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.importing.files import read_image
from fbench.datasets.radiate.calibration import LIDAR, Calibration, read_calibration, rig_of
from fbench.datasets.radiate.files import (
    ANNOTATIONS,
    GPS,
    META,
    Due,
    SequenceFiles,
    calibration_path,
    dues,
    scan,
    sequences,
)
from fbench.datasets.radiate.labels import Annotations, Findings, inside_bev, read_annotations
from fbench.datasets.radiate.radar import DEFAULTS, RADAR, RadiateParams, read_polar, scan_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, describe_params, file_facts, log_id, read_bytes, read_text
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.formats.text import parse_number

COLUMNS = ("x", "y", "z", "intensity", "ring")
_BLOCK = 2**18  # Bytes that one thread parses; small enough for several threads to have some of a sweep
_COUNTS = (3, 3, 3, 3, 4, *[3] * 13)
_PLACE, _QUATERNION, _VELOCITY = 0, 4, 16
_EARTH_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563  # WGS 84 (NIMA TR8350.2, table 3.1)
_META_KEYS = {"name": "sequence", "type": "weather", "set": "set", "version": "version"}


def read_sweep(path: Path, stamp_ns: int) -> PointCloud:
    """Read rows `x,y,z,intensity,ring` without a header; x right, y forward, z up [m]. Raises LogError where a row
    hasn't five numbers, one isn't finite, or a ring isn't 0 to 65535.
    """
    import pyarrow as pa
    from pyarrow import csv

    types = {name: pa.float32() for name in COLUMNS} | {"ring": pa.uint16()}
    data = read_bytes(path)
    try:
        table = csv.read_csv(
            pa.BufferReader(data),
            csv.ReadOptions(use_threads=True, column_names=list(COLUMNS), block_size=_BLOCK),
            convert_options=csv.ConvertOptions(column_types=types, null_values=[], check_utf8=False),
        )
    except pa.ArrowInvalid as error:
        text = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of {','.join(COLUMNS)} ({text})") from error
    columns = [table.column(name).to_numpy() for name in COLUMNS]
    for name, column in zip(COLUMNS, columns, strict=True):
        if not np.isfinite(column).all():
            row = int(np.flatnonzero(~np.isfinite(column))[0]) + 1
            raise LogError(f"{path}: line {row}: {name} isn't a finite number")
    return PointCloud(LIDAR, stamp_ns, stamp_ns, np.stack(columns[:3], axis=1), columns[3], columns[4])


@dataclass(frozen=True, eq=False)
class Fix:
    """What a file tells."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    quaternion_xyzw: Float64
    north_east_mps: tuple[float, float]


def read_fix(path: Path) -> Fix:
    """Read a file. Raises LogError naming file and line that is missing or wrong."""
    lines = read_text(path, 100_000).splitlines()
    if len(lines) < len(_COUNTS):
        raise LogError(f"{path}: {len(lines)} lines, expected {len(_COUNTS)}, is it truncated?")
    lat, lon, alt = _numbers(path, lines, _PLACE)
    if not (abs(lat) < 90 and abs(lon) <= 180 and abs(alt) < _EARTH_M):
        raise LogError(f"{path}: line 1: latitude {lat:g}, longitude {lon:g}, altitude {alt:g} is no place on Earth")
    xyzw = _numbers(path, lines, _QUATERNION)
    if abs(sum(q * q for q in xyzw) - 1) > 1e-2:
        text = lines[_QUATERNION].strip()[:80]
        raise LogError(f"{path}: line {_QUATERNION + 1}: expected a unit quaternion, got {text}")
    north, east, _ = _numbers(path, lines, _VELOCITY)
    return Fix(lat, lon, alt, np.array(xyzw), (north, east))


def _numbers(path: Path, lines: list[str], index: int) -> list[float]:
    where = f"{path}: line {index + 1}"
    texts = lines[index].strip().split(",")
    values = [parse_number(text, where, "a value") for text in texts]
    if len(values) != _COUNTS[index] or not all(abs(value) < 1e9 for value in values):
        raise LogError(f"{where}: expected {_COUNTS[index]} finite numbers")
    return values


class Poses:
    """Makes poses of fixes one after the other.

    World: east, north, up, touching the ellipsoid's normal at the first fix, where the origin is. The place of the
    antenna on the van isn't published, and taken for the body's origin.
    """

    def __init__(self, params: RadiateParams) -> None:
        self._params = params
        self._origin: Fix | None = None
        self._yaw_rad: float | None = None

    def pose(self, fix: Fix, stamp_ns: int) -> Pose | None:
        """Return the pose at a fix; `None` where it isn't known yet where the body points to."""
        rotation, (north, east) = fix.quaternion_xyzw, fix.north_east_mps
        if self._params.heading == "course":
            if math.hypot(north, east) >= self._params.min_speed_mps:
                self._yaw_rad = math.atan2(north, east)
            if self._yaw_rad is None:
                return None
            rotation = np.asarray(Rotation.from_euler("z", self._yaw_rad).as_quat(canonical=True), np.float64)
        self._origin = self._origin or fix
        return Pose(GPS, stamp_ns, stamp_ns, east_north_up_m(fix, self._origin), rotation)


def east_north_up_m(fix: Fix, origin: Fix) -> Float64:
    """Position (3,) [m] in the plane that touches the Earth at another fix; B. Hofmann-Wellenhof, H. Lichtenegger and
    E. Wasle, "GNSS", Springer 2008, section 8.2.
    """
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    x, y, z = _earth_fixed_m(fix) - _earth_fixed_m(origin)
    forth = math.cos(lon) * x + math.sin(lon) * y
    east = math.cos(lon) * y - math.sin(lon) * x
    north = math.cos(lat) * z - math.sin(lat) * forth
    return np.array([east, north, math.cos(lat) * forth + math.sin(lat) * z])


def _earth_fixed_m(fix: Fix) -> Float64:
    lat, lon = math.radians(fix.lat_deg), math.radians(fix.lon_deg)
    squared = _FLATTENING * (2 - _FLATTENING)
    normal = _EARTH_M / math.sqrt(1 - squared * math.sin(lat) ** 2)
    across, z = (normal + fix.alt_m) * math.cos(lat), (normal * (1 - squared) + fix.alt_m) * math.sin(lat)
    return np.array([across * math.cos(lon), across * math.sin(lon), z])


class Radiate:
    """Reads a sequence's folder, or all sequences in a folder; their names are those of their folders.

    A sequence has `Navtech_Polar/NNNNNN.png` and `Navtech_Polar.txt` with the stamps, and may have `velo_lidar/*.csv`,
    `zed_left/*.png`, `zed_right/*.png` and `GPS_IMU_Twist/*.txt`, each with a table of stamps, and
    `annotations/annotations.json` and `meta.json`. The SDK's `default-calib.yaml` must lie in it or beside it, or be
    named. `--frames` chooses radar frames by the numbers of their files; other sensors are cut to the time of these,
    and half a radar period more on either side.
    """

    def __init__(self, params: RadiateParams = DEFAULTS) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        """Names of the folders; see `Importer`."""
        return [path.resolve().name for path in sequences(source)]

    def recordings(self, source: Path, request: ImportRequest) -> Iterator["RadiateRecording"]:
        """Open the sequences; see `Importer`."""
        roots = {path.resolve().name: path for path in sequences(source)}
        for name in request.names:
            yield RadiateRecording(name, roots[name], request, self._params)


class RadiateRecording:
    """One sequence; see `Recording`.

    Stamps are times of arrival (README of the SDK), and stay as they were recorded. A scan arrives when the radar has
    turned once, clockwise from ahead: what is right of ahead was measured a quarter of a second before what is left of
    it, and LiDAR and camera show it with stamps some 0.3 s earlier. Body coordinates are those of the radar.
    """

    def __init__(self, name: str, root: Path, request: ImportRequest, params: RadiateParams) -> None:
        self.name, self._root, self._request, self._params = name, root, request, params
        self._findings = Findings()

    @cached_property
    def _files(self) -> SequenceFiles:
        return scan(self._root, self._request.bad)

    @cached_property
    def _calibration(self) -> Calibration:
        return read_calibration(calibration_path(self._root, self._params.calibration))

    @cached_property
    def _annotations(self) -> Annotations | None:
        path = self._root / ANNOTATIONS
        try:
            return read_annotations(path, self._request.bad) if os.path.lexists(path) else None
        except LogError as error:
            self._request.bad.report(error)
            return None

    @cached_property
    def _dues(self) -> Sequence[Due]:
        offset_ns = int((Decimal(str(self._params.gps_offset_s)) * 1_000_000_000).to_integral_value())
        return dues(self._files, self._request.frames, offset_ns)

    @cached_property
    def rig(self) -> Rig:
        """Sensors and calibration."""
        return rig_of(self._calibration, self._files.sensors, self._params.right_camera)

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the set and of the sequence."""
        metadata = {
            "dataset": "RADIATE",
            "licence": "CC BY-NC-SA 4.0",
            **_meta(self._root / META),
            "reference": RADAR,
            "stamps": "when each message arrived at the recorder, for each sensor its own",
            "radar.rcs_dbsm": "uncalibrated power: grey value of the polar image",
            "truth.height": "assumed: that of the class; labels are from above",
            **describe_params(self._params),
        }
        stamps = (f"{due.sensor} {due.number} {due.stamp_ns}" for due in self._dues)
        paths = [self._root / ANNOTATIONS, self._root / META, *(self._files.path(due) for due in self._dues)]
        facts = [self._calibration.model_dump_json(), *stamps, *file_facts(self._root, paths)]
        return LogInfo(self.name, log_id("radiate", facts, self._request.frames, self._params), metadata)

    @property
    def num_items(self) -> int:
        """A message a file, and the labels of radar frames."""
        return len(self._dues) + sum(due.sensor == RADAR for due in self._dues)

    def items(self) -> Iterator[Message | Truth]:
        """All messages by time, and after each radar scan what was labeled then."""
        poses = Poses(self._params)
        for due in self._dues:
            message = self._message(due, poses)
            if message is not None:
                self._findings.messages[message.sensor] += 1
                self._findings.radar_points += len(message.xyz) if isinstance(message, RadarScan) else 0
                yield message
            if due.sensor == RADAR:
                yield from self._truth(due, message if isinstance(message, RadarScan) else None)

    def _message(self, due: Due, poses: Poses) -> Message | None:
        path = self._files.path(due)
        try:
            if due.sensor == RADAR:
                return scan_of(read_polar(path), due.stamp_ns, self._params.cfar)
            if due.sensor == LIDAR:
                return read_sweep(path, due.stamp_ns)
            if due.sensor == GPS:
                return poses.pose(read_fix(path), due.stamp_ns)
            return read_image(path, due.sensor, due.stamp_ns, self.rig.cameras[due.sensor].size_wh)
        except LogError as error:
            self._request.bad.report(error)
            return None

    def _truth(self, due: Due, scan: RadarScan | None) -> Iterator[Truth]:
        boxes = self._annotations.boxes(due.number, self._params.radar_height_m) if self._annotations else None
        if boxes is None:
            self._findings.unlabeled += 1
            return
        if scan is not None:
            boxes = replace(boxes, num_radar_pts=inside_bev(boxes, scan.xyz).sum(axis=1, dtype=np.int64))
        self._findings.add_boxes(boxes)
        yield Truth(due.stamp_ns, due.stamp_ns, boxes)

    def summary(self) -> Sequence[str]:
        """What was found."""
        num_slots = None if self._annotations is None else self._annotations.num_slots
        return list(self._findings.lines(self._files, self._dues, num_slots, self._params))


def _meta(path: Path) -> dict[str, str]:
    """What a sequence says about itself; may be nothing. Raises LogError where the file isn't an object of JSON."""
    if not path.exists():
        return {}
    try:
        content = json.loads(read_bytes(path, 1_000_000))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: isn't JSON ({str(error)[:100]})") from error
    if not isinstance(content, dict):
        raise LogError(f"{path}: expected an object with name, type, set and version")
    # As `errors` shows texts of others: half a surrogate pair can't be stored.
    told = {ours: str(content[key])[:200] for key, ours in _META_KEYS.items() if key in content}
    return {ours: "".join(c if c.isprintable() else " " for c in text) for ours, text in told.items()}
