"""Times of single points, as drivers write them, relative to the stamp of the cloud."""

import numpy as np

from fbench.replay.arrays import Array, Float64

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_NS_PER_S = 1_000_000_000
_LIMITS = np.iinfo(np.int32)


def offset_ns(times: Array, stamp_ns: int) -> Array | None:
    """Return the times (N,) int32 after `stamp_ns` [ns], or `None` where their meaning isn't clear.

    Integers of 32 bits are ns after the stamp (Ouster `t`, Livox `offset_time`). Floats are seconds: all within
    an int32 of ns around 0 are relative (Velodyne `time`), all that near the stamp are absolute (Hesai, RoboSense
    `timestamp`). What can be both (stamps of the first seconds since 1970), anything else, and what an int32 doesn't
    hold stays unknown: milliseconds of a whole sweep, say.
    """
    if not len(times):
        return np.zeros(0, np.int32)
    if times.dtype.kind == "f":
        seconds = times.astype(np.float64)
        relative, absolute = _fitting(seconds * _NS_PER_S), _fitting(_since(seconds, stamp_ns))
        if relative is None or absolute is None:
            return absolute if relative is None else relative
        return None
    return _fitting(times.astype(np.float64)) if times.dtype.itemsize == 4 else None


def _since(seconds: Float64, stamp_ns: int) -> Float64:
    """Absolute seconds as ns after the stamp; whole seconds are taken off first, which loses nothing."""
    whole, rest = divmod(stamp_ns, _NS_PER_S)
    return (seconds - whole) * _NS_PER_S - rest


def _fitting(ns: Float64) -> Array | None:
    fits = bool(np.all((ns >= _LIMITS.min) & (ns <= _LIMITS.max)))
    return np.rint(ns).astype(np.int32) if fits else None
