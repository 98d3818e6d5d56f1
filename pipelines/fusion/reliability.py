"""Reliability of sensors: how much points say, and shares of objects that each sensor sees at present."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Source


def saturate(num: Float64 | int, full: float) -> Float64:
    """How much `num` points say, 0 to 1: 1 - exp(-num / full)."""
    return np.asarray(1 - np.exp(-num / full), np.float64)


def sureness(probability: Float64) -> Float64:
    """How far objects (N,) count for what sensors that should see them are worth: none below 1/2, 1 where certain."""
    return np.asarray(np.clip(2 * probability - 1, 0.0, 1.0), np.float64)


_BANDS = 4


@dataclass(frozen=True)
class AgreementParams(CheckedParams, prefix="fusion.agreement"):
    """How well each sensor works right now: the share of objects which others are sure of that it sees, too.

    The weather isn't known: a camera that sees little of what LiDAR and radar see is worth little, and what it
    doesn't see may be there all the same. Shares are kept apart for near and far objects.
    """

    camera: float = in_range(0.8, 0, 1)
    """Share of the objects in view that a camera is expected to see before anything is known."""
    lidar: float = in_range(0.9, 0, 1)  # The same of LiDAR.
    radar: float = in_range(0.25, 0, 1)  # The same of radar, which sees what moves.
    weight: float = in_range(4.0, 0.01, 1e6)  # So many objects make what was seen weigh as much as the expectation.
    frames: float = in_range(30.0, 0.1, 1e6)  # After so many frames what was seen counts 1/e.
    band_m: float = in_range(15.0, 0.1, 1000)  # Width of the bands of distance [m]; the fourth has no end.


class SensorReliability:
    """Counts, for each sensor and band of distance, sure objects that it should have seen, and those that it saw."""

    def __init__(self, params: AgreementParams) -> None:
        self._params = params
        self.reset()

    def reset(self) -> None:
        """Expect of all sensors what is expected of them at the start."""
        self._counts: dict[str, Float64] = {}

    def share(self, sensor: str, kind: str, distance_m: Float64) -> Float64:
        """Share (N,) of the objects at these distances that a sensor sees where nothing hides them."""
        p = self._params
        expected = {"camera": p.camera, "lidar": p.lidar, "radar": p.radar}[kind]
        seen, asked = self._counts.get(sensor, np.zeros((2, _BANDS)))
        shares = (seen + p.weight * expected) / (asked + p.weight)
        return np.asarray(shares[self._band(distance_m)], np.float64)

    def learn(self, sensor: str, distance_m: Float64, sure: Float64, seen: Bool) -> None:
        """Take in one frame: how sure others are (N,) of objects that the sensor should see, and whether it did."""
        band = self._band(distance_m)
        asked = np.bincount(band, weights=sure, minlength=_BANDS)
        hits = np.bincount(band, weights=sure * seen, minlength=_BANDS)
        before = self._counts.get(sensor, np.zeros((2, _BANDS)))
        self._counts[sensor] = before * np.exp(-1.0 / self._params.frames) + np.array([hits, asked])

    def _band(self, distance_m: Float64) -> Int64:
        return np.minimum(distance_m / self._params.band_m, _BANDS - 1).astype(np.int64)


_BEFORE, _SEEN_BEFORE = 20.0, 18.0  # Before anything was seen, cameras are taken to have seen 9 of 10 objects
_KEPT = 0.97  # Share of what was seen that still counts one frame later
_BOTH = int(Source.L) | int(Source.R)


class CameraReliability:
    """Share of the objects that both LiDAR and radar see which cameras see too, over some twenty frames."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin a segment."""
        self._num, self._num_seen = _BEFORE, _SEEN_BEFORE

    @property
    def share(self) -> float:
        """0 to 1."""
        return self._num_seen / self._num

    def learn(self, objects: Boxes2D) -> None:
        """Take the objects of a frame that are reported in images of cameras that worked."""
        sources = np.zeros(0, np.uint8) if objects.sources is None else objects.sources
        score = np.zeros(len(objects)) if objects.score is None else objects.score
        sure = np.where((sources & _BOTH) == _BOTH, sureness(score), 0.0)
        self._num = _KEPT * self._num + float(sure.sum())
        self._num_seen = _KEPT * self._num_seen + float(sure[(sources & int(Source.C)) > 0].sum())
        if self._num < 1.0:  # long without anything to learn from: as in the beginning
            self.reset()
