"""Statistics and rules of COCO: thresholds, area ranges, numbers of estimates."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, Int64, freeze_fields


class Outcome(IntEnum):
    """Of an estimate, at one threshold and range of area."""

    FALSE_ALARM = 0
    HIT = 1
    IGNORED = 2


@dataclass(frozen=True, eq=False)
class Ranked:
    """M estimates of one class of one sequence."""

    sequence: str
    place: Int64  # (M, 3) frame, number of the camera, and place in the image by score: no two are equal
    score: Float64  # (M,)
    outcome: Array  # (A, T, M) uint8 `Outcome` for A ranges of area and T thresholds

    def __post_init__(self) -> None:
        freeze_fields(self, place=("i8", ("M", 3)), score=("f8", ("M",)), outcome=("u1", ("A", "T", "M")))


@dataclass(frozen=True)
class ClassStatistics:
    """One class over some sequences."""

    num_truth: tuple[int, ...]  # Boxes to be found in each range of area
    num_crowds: int
    parts: tuple[Ranked, ...]  # One a sequence, in any order

    def __add__(self, other: "ClassStatistics") -> "ClassStatistics":
        num_truth = tuple(a + b for a, b in zip(self.num_truth, other.num_truth, strict=True))
        return ClassStatistics(num_truth, self.num_crowds + other.num_crowds, self.parts + other.parts)

    def rank(self) -> tuple[Int64, Array]:
        """Place in the image (M,) and outcome (A, T, M) of all estimates, the best score first.

        Equal scores stand by sequence, frame, camera and place in the image, scores that aren't numbers last.
        """
        parts = sorted(self.parts, key=lambda part: part.sequence)
        place, score = np.concatenate([p.place for p in parts]), np.concatenate([p.score for p in parts])
        sequence = np.repeat(np.arange(len(parts)), [len(p.score) for p in parts])
        order = np.lexsort((place[:, 2], place[:, 1], place[:, 0], sequence, -score))
        return place[order, 2], np.concatenate([p.outcome for p in parts], axis=2)[..., order]


@dataclass(frozen=True)
class CocoStatistics:
    """All classes over some sequences."""

    classes: Mapping[str, ClassStatistics]
    num_images: int
    num_invalid_truth: int  # Boxes that aren't finite or have a negative size; left out
    num_invalid_estimates: int  # Counted as false alarms

    def __add__(self, other: "CocoStatistics") -> "CocoStatistics":
        classes = dict(self.classes)
        for label, more in other.classes.items():
            classes[label] = classes[label] + more if label in classes else more
        return CocoStatistics(
            classes,
            self.num_images + other.num_images,
            self.num_invalid_truth + other.num_invalid_truth,
            self.num_invalid_estimates + other.num_invalid_estimates,
        )


@dataclass(frozen=True)
class AreaRange:
    """Sizes of boxes that count; others are ignored."""

    name: str  # As in `aps`: empty for all
    low_px2: float
    high_px2: float  # Both ends belong to it

    def holds(self, area_px2: Float64) -> Bool:
        """Tell which areas (N,) lie in it; unknown ones (NaN) do."""
        inside: Bool = ~((area_px2 < self.low_px2) | (area_px2 > self.high_px2))
        return inside


@dataclass(frozen=True)
class CocoRules:
    """Parameters of pycocotools' `Params` for boxes."""

    thresholds: tuple[float, ...] = tuple(np.linspace(0.5, 0.95, 10).tolist())
    """Least intersection over union; results are averaged over them."""
    num_recalls: int = 101  # Precision is read at as many recalls from 0 to 1
    max_estimates: tuple[int, ...] = (1, 10, 100)  # Of one class in one image, the best scores first; ascending
    areas: tuple[AreaRange, ...] = (
        AreaRange("", 0.0, 1e10),
        AreaRange("s", 0.0, 32.0**2),
        AreaRange("m", 32.0**2, 96.0**2),
        AreaRange("l", 96.0**2, 1e10),
    )
    """All first."""
