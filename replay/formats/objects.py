"""Labeled objects as files tell them one by one: parsing of lines and values, and the boxes that they make."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.data.arrays import Array, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import label

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Solid:
    """A 3D box."""

    center_m: Triple
    size_lwh_m: Triple
    yaw_pitch_roll_rad: Triple
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    velocity_mps: Triple | None = None
    frame: str = ""
    """Its coordinate frame; empty: the body."""


@dataclass(frozen=True, slots=True)
class Flat:
    """A box in an image."""

    camera: str
    xyxy_px: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Labelled:
    """One object at one instant; `None` where the file doesn't tell."""

    source_label: str
    solid: Solid | None = None
    flat: Flat | None = None
    label: str | None = None
    """Where it doesn't follow from `source_label`."""
    score: float | None = None
    track_id: int | None = None
    ignore: bool | None = None
    visibility: float | None = None
    occlusion: float | None = None
    truncation: float | None = None
    attribute: str | None = None
    num_lidar_pts: int | None = None
    alpha_rad: float | None = None
    """KITTI's angle of observation, which boxes have no place for."""


_OPTIONAL: tuple[tuple[str, Any, Any], ...] = (
    ("score", np.float64, np.nan), ("track_id", np.int64, -1), ("ignore", np.bool_, False),
    ("visibility", np.float64, np.nan), ("occlusion", np.float64, np.nan), ("truncation", np.float64, np.nan),
    ("attribute", np.str_, ""), ("num_lidar_pts", np.int64, -1),
)  # fmt: skip


def solids(objects: Sequence[Labelled]) -> Boxes3D:
    """Return the 3D boxes of objects, each in its own coordinate frame."""
    rows = [(row, row.solid) for row in objects if row.solid is not None]
    if not rows:
        return Boxes3D.empty()
    angles = np.array([solid.yaw_pitch_roll_rad for _, solid in rows], np.float64)
    upright = not np.any(angles[:, 1:])
    return Boxes3D(
        np.array([solid.center_m for _, solid in rows], np.float64),
        np.array([solid.size_lwh_m for _, solid in rows], np.float64),
        angles[:, 0],
        pitch_rad=None if upright else angles[:, 1],
        roll_rad=None if upright else angles[:, 2],
        velocity_mps=_velocities([solid for _, solid in rows]),
        **_common([row for row, _ in rows]),
    )


def flats(objects: Sequence[Labelled]) -> Boxes2D:
    """Return the boxes in images of objects."""
    rows = [(row, row.flat) for row in objects if row.flat is not None]
    if not rows:
        return Boxes2D.empty()
    return Boxes2D(
        np.array([flat.camera for _, flat in rows], np.str_),
        np.array([flat.xyxy_px for _, flat in rows], np.float64),
        **_common([row for row, _ in rows]),
    )


def _velocities(rows: Sequence[Solid]) -> Array | None:
    told = [row.velocity_mps for row in rows]
    if all(velocity is None for velocity in told):
        return None
    return np.array([(np.nan,) * 3 if velocity is None else velocity for velocity in told], np.float64)


def _common(rows: Sequence[Labelled]) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "label": np.array([label(row.source_label) if row.label is None else row.label for row in rows], np.str_),
        "source_label": text_array([row.source_label for row in rows]),
    }
    for name, dtype, absent in _OPTIONAL:
        values = [getattr(row, name) for row in rows]
        if any(value is not None for value in values):
            there = [absent if value is None else value for value in values]
            columns[name] = text_array(there) if dtype is np.str_ else np.array(there, dtype)
    return columns


_MAX_NS = 2**63 - 1
_MAX_S = Decimal(_MAX_NS // 10**9 + 1)
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)$", re.ASCII)
_HASHED = 1 << 62
"""From here on ids stand for texts."""


def stamp_of_seconds(text: str) -> int:
    """Return a stamp [ns] from seconds as a decimal text, without the loss of a float.

    Raises:
        ValueError: where it isn't a number, or doesn't fit an int64.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no number of seconds") from None
    if not seconds.is_finite() or not 0 <= seconds < _MAX_S:
        raise ValueError(f"'{text[:40]}' is no stamp")
    stamp_ns = int(seconds.scaleb(9).to_integral_value())
    if stamp_ns > _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no stamp")
    return stamp_ns


def stamp_of_time(text: str) -> int:
    """Return a stamp [ns] from seconds (or, where they are too many, ms, us or ns) since 1970, or a time in ISO 8601.

    Raises:
        ValueError: where it is none of these.
    """
    if "-" in text[1:] and ":" in text:
        found = _of_date(text.strip().replace(" ", "T"))
        if found < 0:
            raise ValueError(f"'{text[:40]}' is no stamp")
        return found
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no time") from None
    if not value.is_finite() or not 0 <= value <= _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no time")
    digits = next(shift for limit, shift in ((11, 9), (14, 6), (17, 3), (19, 0)) if value < Decimal(10) ** limit)
    return min(int(value.scaleb(digits).to_integral_value()), _MAX_NS)


def _of_date(text: str) -> int:
    """Return ns since 1970 of a date and time, which is in UTC unless it ends in an offset such as +01:00."""
    zone = _ZONE.search(text)
    ahead_ns = 0
    if zone is not None:
        minutes = 60 * int(zone[2]) + int(zone[3])
        ahead_ns = minutes * 60_000_000_000 * (-1 if zone[1] == "-" else 1)
    local = text.removesuffix("Z") if zone is None else text[: zone.start()]
    return int(np.datetime64(local, "ns").astype(np.int64)) - ahead_ns


def track_number(text: str) -> int:
    """Return a track id for what a file calls an object: whole numbers stay, other texts become a number of their own
    (a digest, so that it depends on nothing else); -1 where there is none.
    """
    text = text.strip()
    if not text:
        return -1
    if text.lstrip("-").isascii() and text.lstrip("-").isdigit() and len(text) < 19:
        return max(int(text), -1)
    digest = blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest()
    return _HASHED + int.from_bytes(digest, "little") % _HASHED


def parse_number(text: str, where: str, column: str) -> float:
    """Return a number, also one that isn't finite.

    Raises:
        LogError: where the text is none.
    """
    try:
        return float(text)
    except ValueError:
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a number") from None


def whole(text: str, where: str, column: str) -> int:
    """Return a whole number that fits an int64.

    Raises:
        LogError: where the text is none.
    """
    value = parse_number(text, where, column)
    if not (abs(value) < 2**53 and value == int(value)):
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a whole number")
    return int(value)


def angles(x: float, y: float, z: float, w: float, where: str) -> Triple:
    """Return yaw, pitch, roll [rad] of a quaternion, R = Rz(yaw) Ry(pitch) Rx(roll); NaN where it isn't finite.

    Raises:
        LogError: where it is zero.
    """
    xyzw = np.array([x, y, z, w])
    if not np.isfinite(xyzw).all():
        return np.nan, np.nan, np.nan
    norm = float(np.hypot(np.hypot(x, y), np.hypot(z, w)))
    if norm == 0:
        raise LogError(f"{where}: rotation is the quaternion 0 0 0 0")
    if x == y == 0:
        return float(2 * np.arctan2(z, w)), 0.0, 0.0
    yaw, pitch, roll = Rotation.from_quat(xyzw / norm).as_euler("ZYX", suppress_warnings=True)
    return float(yaw), float(pitch), float(roll)


_MAX_LINE = 100_000
_MAX_LINES = 5_000_000
MAX_FRAMES = 10_000_000
"""Files that count more frames than this are refused."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line that isn't empty."""

    path: Path
    number: int
    """The file's first line is 1."""
    fields: list[str]

    @property
    def where(self) -> str:
        """For errors."""
        return f"{self.path} line {self.number}"


def lines(path: Path, separator: str | None = None) -> Iterator[Line]:
    """Yield the lines of a text, split at blanks or at a separator; a byte order mark and blank lines are no matter.

    Raises:
        LogError: where the file can't be read, or is no text.
        LimitError: where a line has no end.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            for number, text in enumerate(iter(lambda: file.readline(_MAX_LINE), ""), 1):
                if len(text) >= _MAX_LINE:
                    raise LimitError(f"{path} line {number}: longer than {_MAX_LINE} characters")
                if number > _MAX_LINES:
                    raise LimitError(f"{path}: more than {_MAX_LINES} lines; split it, or use Parquet")
                fields = [field.strip() for field in text.strip().split(separator)] if text.strip() else []
                if fields:
                    yield Line(path, number, fields)
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason} at byte {error.start})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def frame_number(text: str, where: str) -> int:
    """Return the number of a frame.

    Raises:
        LogError: where it is none.
        LimitError: where it is beyond all reason.
    """
    try:
        number = int(text[:40])
    except ValueError:
        raise LogError(f"{where}: frame is '{text[:40]}', expected a whole number") from None
    if not 0 <= number < MAX_FRAMES:
        raise LimitError(f"{where}: frame is {number}, expected 0 to {MAX_FRAMES - 1}")
    return number


_PIECE = 2**20


def digest_of(path: Path) -> str:
    """Return the blake2b-128 of a file; of a folder, over names and digests of all its files in the order of names.

    Raises:
        LogError: where a file can't be read.
    """
    if path.is_file():
        return _digest(path)
    whole = blake2b(digest_size=16)
    for file in sorted(file for file in path.rglob("*") if file.is_file()):
        whole.update(f"{file.relative_to(path).as_posix()}\n{_digest(file)}\n".encode("utf-8", "surrogateescape"))
    return whole.hexdigest()


def _digest(path: Path) -> str:
    found = blake2b(digest_size=16)
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                found.update(piece)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    return found.hexdigest()
