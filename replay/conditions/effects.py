"""How much conditions changed, for the manifest and the report."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.contracts.conditions import Measurement
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image

_EVERY = 16  # Of the rows and columns of an image, for the mean difference


class Effects:
    """Counts by sensor: what came and went, and the size of the change; the order of messages doesn't matter but for
    the last digits, which aren't kept.
    """

    def __init__(self) -> None:
        self._sums: dict[str, dict[str, float]] = {}

    def add(self, recorded: Measurement, results: Sequence[Measurement]) -> None:
        """Count what became of one message."""
        own = self._sums.setdefault(recorded.sensor, {})
        changed = [result for result in results if result is not recorded]
        pairs: dict[str, float] = {
            "messages": 1, "dropped": not results, "added": max(0, len(results) - 1),
            "changed": bool(changed) or not results,
            "late": any(result.log_ns > recorded.log_ns for result in results),
            "restamped": any(result.stamp_ns != recorded.stamp_ns for result in results),
        }  # fmt: skip
        pairs = {name: int(value) for name, value in pairs.items()} | (
            _compare(recorded, results[0]) if results else {}
        )
        for name, value in pairs.items():
            own[name] = own.get(name, 0) + value

    def rows(self) -> dict[str, dict[str, float]]:
        """Return sums by sensor; those of real numbers rounded to 6 digits."""
        return {
            sensor: {name: value if isinstance(value, int) else float(f"{value:.6g}") for name, value in sums.items()}
            for sensor, sums in sorted(self._sums.items())
        }


def _compare(before: Measurement, after: Measurement) -> dict[str, float]:
    """Points that came, went and moved [m, summed], or the mean difference of gray levels."""
    if isinstance(before, Image) or isinstance(after, Image):
        if before is after or not (isinstance(before, Image) and isinstance(after, Image)):
            return {"gray_levels": 0.0}
        old, new = decode(before), decode(after)
        if old is None or new is None or old.shape != new.shape:
            return {"gray_levels": 0.0}
        difference = np.abs(old[::_EVERY, ::_EVERY].astype(np.int16) - new[::_EVERY, ::_EVERY])
        return {"gray_levels": float(difference.mean())}
    counts: dict[str, float] = {"points_before": len(before.xyz), "points_after": len(after.xyz)}
    if len(before.xyz) == len(after.xyz) and before is not after:
        distance = np.sqrt(((before.xyz.astype(np.float64) - after.xyz) ** 2).sum(axis=1))
        counts |= {"points_moved": int(np.count_nonzero(distance)), "moved_m": float(np.nansum(distance))}
    return counts
