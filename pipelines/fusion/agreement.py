"""How well each sensor works right now, by what others are sure of."""

import numpy as np

from fbench.pipelines.fusion.params import AgreementParams
from fbench.replay.arrays import Bool, Float64, Int64

_BANDS = 4


class Agreement:
    """Counts, for each sensor and band of distance, sure objects that it should have seen, and those that it saw."""

    def __init__(self, params: AgreementParams) -> None:
        self._params = params
        self._counts: dict[str, Float64] = {}

    def reset(self) -> None:
        """Expect of all sensors what is expected of them at the start."""
        self._counts = {}

    def share(self, sensor: str, kind: str, distance_m: Float64) -> Float64:
        """Share (N,) of the objects at these distances that a sensor sees where nothing hides them."""
        p = self._params
        expected = {"camera": p.camera, "lidar": p.lidar, "radar": p.radar}[kind]
        seen, asked = self._counts.get(sensor, np.zeros((2, _BANDS)))
        shares = (seen + p.weight * expected) / (asked + p.weight)
        return np.asarray(shares[self._band(distance_m)], np.float64)

    def observe(self, sensor: str, distance_m: Float64, sure: Float64, seen: Bool) -> None:
        """Take in one frame: how sure others are (N,) of objects that the sensor should see, and whether it did."""
        band = self._band(distance_m)
        asked = np.bincount(band, weights=sure, minlength=_BANDS)
        hits = np.bincount(band, weights=sure * seen, minlength=_BANDS)
        before = self._counts.get(sensor, np.zeros((2, _BANDS)))
        self._counts[sensor] = before * np.exp(-1.0 / self._params.frames) + np.array([hits, asked])

    def _band(self, distance_m: Float64) -> Int64:
        return np.minimum(distance_m / self._params.band_m, _BANDS - 1).astype(np.int64)
