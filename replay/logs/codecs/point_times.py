"""Times of points: fields under the names and in the units of many drivers, as offsets from the stamp of a cloud."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fbench.replay.data.arrays import Array, Float64
from fbench.replay.logs.codecs.packed_points import Columns

_NAMES = ("t", "ts", "time", "timestamp", "time_stamp", "offset_time")
_STEMS = r"|t|ts|dt|time|timestamp|time_?stamp|stamp|offset|time_?offset|offset_?time|relative_?time"
_UNITS: Mapping[str, int] = {
    "ns": 1, "nsec": 1, "nsecs": 1, "nanos": 1, "nanosec": 1, "nanoseconds": 1, "us": 1_000, "usec": 1_000,
    "ms": 1_000_000, "msec": 1_000_000, "s": 1_000_000_000, "sec": 1_000_000_000, "secs": 1_000_000_000,
    "seconds": 1_000_000_000,
}  # fmt: skip
_NAMED = re.compile(rf"({_STEMS})(?:_|(?=...))({'|'.join(sorted(_UNITS, key=len, reverse=True))})", re.ASCII)
_LIKE_TIME = re.compile(r"t|ts|dt|.*time.*|.*stamp.*", re.ASCII | re.DOTALL)
_S = 1_000_000_000
_LIMITS = np.iinfo(np.int32)


class PointTimes(NamedTuple):
    """When the points of a cloud were measured."""

    offset_ns: Array | None  # (N,) int32 after the stamp; `None` where nothing says it
    doubt: str = ""  # Why fields that seem to be times aren't used


def read_times(columns: Columns, stamp_ns: int) -> PointTimes:
    """Find the times of points. The first of these fields that makes sense counts: `t`, `ts`, `time`, `timestamp`,
    `time_stamp`, `offset_time`; seconds and nanoseconds in two fields (`timestamp_sec`, `timestamp_nsec`); names that
    end with a unit (`time_us`). Raises PointsError where such a field lies outside the points.
    """
    names = [name for name in columns.names if _LIKE_TIME.fullmatch(name) or _unit(name)]
    for name in _NAMES:
        times = columns.get((name,))
        offsets = None if times is None else offset_ns(times, stamp_ns)
        if offsets is not None:
            return PointTimes(offsets)
    for second, nanosecond in _pairs(names):
        parts = columns.get((second,)), columns.get((nanosecond,))
        if (offsets := _join(*parts, stamp_ns)) is not None:
            return PointTimes(offsets)
    paired = {name for pair in _pairs(names) for name in pair}
    for name in names:
        times, unit = columns.get((name,)), _unit(name)
        if times is not None and unit and name not in paired and (offsets := _scale(times, unit, stamp_ns)) is not None:
            return PointTimes(offsets)
    return PointTimes(None, f"its points have {', '.join(map(_quote, names))}" if names else "")


def _quote(name: str) -> str:
    return f"'{name[:40]}'"


def _unit(name: str) -> int:
    """Nanoseconds of the unit that a name ends with, 0 without one; one of a letter or two comes after `_`."""
    found = _NAMED.fullmatch(name)
    return _UNITS[found[2]] if found else 0


def _pairs(names: list[str]) -> list[tuple[str, str]]:
    """Fields with whole seconds, each with that of the nanoseconds within them."""
    stems = {name: found[1] for name in names if (found := _NAMED.fullmatch(name))}
    seconds, nanoseconds = ([name for name in stems if _unit(name) == unit] for unit in (_S, 1))
    return [(a, b) for a in seconds for b in nanoseconds if stems[a] == stems[b]]


def _join(seconds: Array | None, nanoseconds: Array | None, stamp_ns: int) -> Array | None:
    if seconds is None or nanoseconds is None:
        return None
    whole, rest = seconds.astype(np.float64) - stamp_ns // _S, nanoseconds.astype(np.float64)
    if not bool(((rest >= 0) & (rest < _S)).all()):  # NaN, too
        return None
    relative = _fit(seconds.astype(np.float64) * _S + rest)
    return _choose(relative, _fit(whole * _S + (rest - stamp_ns % _S)))


def _scale(times: Array, unit: int, stamp_ns: int) -> Array | None:
    """Times in a unit after the stamp, or since 1970; whole seconds are no times of points."""
    if times.dtype.kind in "iu" and unit == _S:
        return None
    if times.dtype.kind in "iu" and times.dtype.itemsize == 8:
        return _choose(_fit(times.astype(np.float64) * unit), _fit(_since(times, stamp_ns, unit)))
    values = times.astype(np.float64)
    return _choose(_fit(values * unit), _fit((values - stamp_ns // unit) * unit - stamp_ns % unit))


def offset_ns(times: Array, stamp_ns: int) -> Array | None:
    """Return the times (N,) int32 after `stamp_ns` [ns], or `None` where their meaning isn't clear.

    Integers of 32 bits are ns after the stamp (Ouster `t`, Livox `offset_time`), those of 64 bits that, or ns since
    1970 (Luminar, as eight bytes) or us. Floats are seconds: all within an int32 of ns around 0 are relative (Velodyne
    `time`), all that near the stamp are absolute (Hesai, RoboSense `timestamp`), or ns since 1970 (Livox `timestamp`).
    What can be several of these (stamps of the first seconds since 1970), anything else, and what an int32 doesn't hold
    stays unknown: milliseconds of a whole sweep, say.
    """
    if not len(times):
        return np.zeros(0, np.int32)
    kind, size = times.dtype.kind, times.dtype.itemsize
    if kind == "f":
        seconds, (whole, rest) = times.astype(np.float64), divmod(stamp_ns, _S)
        absolute = _fit((seconds - whole) * _S - rest)  # whole seconds come off first, which loses nothing
        return _choose(_fit(seconds * _S), absolute, _fit(seconds - stamp_ns) if size == 8 else None)
    if size == 8:
        since = (_fit(_since(times, stamp_ns, unit)) for unit in (1, 1_000))
        return _choose(_fit(times.astype(np.float64)), *since)
    return _fit(times.astype(np.float64)) if size == 4 else None


def _since(times: Array, stamp_ns: int, unit: int) -> Float64:
    """Integers in a unit since 1970 as ns after the stamp; those that don't fit wrap around, far away."""
    ticks = times.astype(np.int64) - np.int64(stamp_ns // unit)
    return ticks.astype(np.float64) * unit - stamp_ns % unit


def _choose(*options: Array | None) -> Array | None:
    """The only meaning that makes sense."""
    found = [option for option in options if option is not None]
    return found[0] if len(found) == 1 else None


def _fit(ns: Float64) -> Array | None:
    fits = bool(np.all((ns >= _LIMITS.min) & (ns <= _LIMITS.max)))
    return np.rint(ns).astype(np.int32) if fits else None
