"""Findings about ground truth."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.arrays import Array, Bool, Int64
from fbench.replay.boxes import Boxes2D
from fbench.replay.check.finding import Finding, finding
from fbench.replay.data import Boxes, Truth
from fbench.replay.truth.fitted import is_real
from fbench.replay.truth.labelling import TOLERANCE_NS


@dataclass
class TruthCheck:
    """Looks at each message of truth and keeps its stamp."""

    num_boxes: int = 0
    num_repeated: int = 0
    num_unreal: int = 0
    first_repeated: str = ""
    first_unreal: str = ""
    _stamps: "array[int]" = field(default_factory=lambda: array("q"))
    _numbers: "array[int]" = field(default_factory=lambda: array("q"))

    def add(self, truth: Truth) -> None:
        """Look at one message."""
        self._stamps.append(truth.stamp_ns)
        self._numbers.append(-1 if truth.frame_number is None else truth.frame_number)
        for boxes in (truth.boxes3d, truth.boxes2d):
            if boxes is not None:
                self._boxes(truth.stamp_ns, boxes)

    @property
    def num_messages(self) -> int:
        """Messages so far."""
        return len(self._stamps)

    def labelled(self, stamps: Int64, numbers: Int64) -> Bool:
        """Tell which frames, by stamp and number (-1: none), have truth."""
        return _near(stamps, np.array(self._stamps, np.int64)) | _numbered(numbers, np.array(self._numbers, np.int64))

    def findings(self, stamps: Int64, numbers: Int64) -> Iterator[Finding]:
        """Judge the truth of a log with these frames."""
        num = self.num_messages
        if num == 0:
            yield finding("GT001", "", "no ground truth", 0)
            return
        if self.num_repeated:
            text = f"{self.num_repeated} of {self.num_boxes} boxes have the id of another one of their frame"
            yield finding("GT003", "truth", text, self.num_repeated, self.first_repeated)
        if self.num_unreal:
            text = f"{self.num_unreal} of {self.num_boxes} boxes aren't finite or have no size"
            yield finding("GT004", "truth", text, self.num_unreal, self.first_unreal)
        own, own_numbers = np.array(self._stamps, np.int64), np.array(self._numbers, np.int64)
        lost = np.flatnonzero(~(_near(own, stamps) | _numbered(own_numbers, numbers)))
        if len(lost):
            text = f"{len(lost)} of {num} messages of truth belong to no frame"
            yield finding("GT006", "truth", text, len(lost), f"stamp {int(own[lost[0]])} ns")

    def _boxes(self, stamp_ns: int, boxes: Boxes) -> None:
        where = f"stamp {stamp_ns} ns"
        self.num_boxes += len(boxes)
        if repeated := _num_repeated(boxes):
            self.num_repeated += repeated
            self.first_repeated = self.first_repeated or where
        if unreal := int(np.count_nonzero(~is_real(boxes))):
            self.num_unreal += unreal
            self.first_unreal = self.first_unreal or where


def _num_repeated(boxes: Boxes) -> int:
    """How many boxes have the id of one before them; -1 is none, and in images each camera has ids of its own."""
    if boxes.track_id is None:
        return 0
    cameras = boxes.camera.tolist() if isinstance(boxes, Boxes2D) else [""] * len(boxes)
    keys = [key for key in zip(cameras, boxes.track_id.tolist(), strict=True) if key[1] >= 0]
    return len(keys) - len(dict.fromkeys(keys))


def _near(stamps: Int64, others: Int64) -> Bool:
    """Tell which stamps have another one within the tolerance of labelling."""
    ordered = np.sort(others, kind="stable")
    if len(ordered) == 0:
        return np.zeros(len(stamps), bool)
    after = np.searchsorted(ordered, stamps)
    best = np.minimum(
        np.abs(stamps - ordered[np.minimum(after, len(ordered) - 1)]),
        np.abs(stamps - ordered[np.maximum(after, 1) - 1]),
    )
    near: Bool = best <= TOLERANCE_NS
    return near


def _numbered(numbers: Array, others: Array) -> Bool:
    same: Bool = (numbers >= 0) & np.isin(numbers, others)
    return same
