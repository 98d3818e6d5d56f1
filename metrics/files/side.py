"""One side, truth or estimates, of one sequence as its files hold it, with warnings about them."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fbench.metrics.core.sequence import Objects, Space
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import MAX_MAGNITUDE


@dataclass(frozen=True)
class Doubt:
    """One kind of oddity in one sequence."""

    what: str
    """Of one: `box without a velocity`."""
    num: int
    where: str
    """The first of them; empty where that says nothing."""


@dataclass
class Doubts:
    """Those of all sequences, by their kind."""

    nums: dict[str, int] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)

    def add(self, doubts: Iterable[Doubt]) -> None:
        """Count some."""
        for doubt in doubts:
            if doubt.num:
                self.nums[doubt.what] = self.nums.get(doubt.what, 0) + doubt.num
                self.places.setdefault(doubt.what, doubt.where)

    def lines(self) -> list[str]:
        """Return a line a kind, with the first place."""
        places = {what: f": {where}{' ...' if self.nums[what] > 1 else ''}" for what, where in self.places.items()}
        return [f"{num} x {what}{places[what] if self.places[what] else ''}" for what, num in self.nums.items()]


NO_CAMERA: Text = np.array([], np.str_)


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes with what says when and where they were."""

    objects: Objects
    """Their `step` is the key: number of the frame from 0, or stamp [ns]."""
    keys: Int64 | None = None
    """Ascending keys of all frames that the source knows, also empty ones; `None`: from 0 to the highest."""
    has_stamps: bool = False
    """Whether keys are stamps."""
    num_frames: int | None = None
    """Where the source says it."""
    camera: Text = field(default_factory=NO_CAMERA.copy)
    """(N,) whose image each rectangle is in; empty (0,): nobody says."""
    space: str = ""
    """Coordinate frame of solids; empty: nobody says."""
    first_pixel: int = 0
    """Position of the middle of the first pixel: MOTChallenge counts from 1."""
    ego_m: Float64 | None = None
    """(keys, 3) where the body is, NaN where nobody says."""
    are_ordered: bool = True
    """Whether keys follow time; tokens without a table of samples don't."""
    lists_frames: bool = False
    """Whether frames without boxes have an entry too, as in submissions and folders of images."""
    doubts: tuple[Doubt, ...] = ()
    """What is odd about these boxes, as results."""


def objects_of(columns: dict[str, Any]) -> tuple[Objects, Int64]:
    """Return objects in the order of their steps, those of one step as they came, and the order (N,) in which they are.

    Args:
        columns: Fields of `Objects` by name; unsorted; `None` and absent ones are unknown.
    """
    if not len(columns["step"]):
        return nothing(), np.zeros(0, np.int64)
    order = np.argsort(columns["step"], kind="stable")
    found: dict[str, Any] = columns
    if (np.diff(columns["step"]) < 0).any():
        found = {name: None if value is None else value[order] for name, value in columns.items()}
    return Objects(**found), order


def nothing() -> Objects:
    """Return no objects, of both kinds."""
    none, triple = np.zeros(0), np.zeros((0, 3))
    return Objects(np.zeros(0, np.int64), np.zeros(0, "U1"), np.zeros(0, np.int64), none, np.zeros((0, 4)), triple,
                   triple, none)  # fmt: skip


def unreal(objects: Objects, space: Space = "both") -> Bool:
    """Tell which boxes (N,) aren't finite, or have no size; also those that are neither in an image nor in space.

    Args:
        objects: N boxes, with rectangles, solids or both.
        space: Where boxes are compared: a rectangle without size is no matter in space (`3d`), nor a solid without size
            in images (`2d`). Nothing may be infinite anywhere.
    """
    bad, anywhere = [~np.isfinite(objects.score)], [np.zeros(len(objects), bool)]
    if objects.xyxy_px is not None:
        there, finite = _there(objects.xyxy_px), _are_finite(objects.xyxy_px)
        sizes = np.where(finite[:, None], objects.xyxy_px, 0.0)
        bad.append(there & ~(finite & ((space == "3d") | _are_positive(sizes[:, 2:] - sizes[:, :2]))))
        anywhere.append(there)
    if objects.center_m is not None and objects.size_lwh_m is not None and objects.yaw_rad is not None:
        numbers = np.column_stack([objects.center_m, objects.size_lwh_m, objects.yaw_rad])
        there = _there(numbers)
        bad.append(there & ~(_are_finite(numbers) & ((space == "2d") | _are_positive(objects.size_lwh_m))))
        anywhere.append(there)
    found: Bool = np.any(bad, axis=0) | ~np.any(anywhere, axis=0)
    return found


def has_solids(objects: Objects) -> bool:
    """Tell whether any box has one, or there are no boxes at all."""
    return objects.center_m is not None and (not len(objects) or bool(_there(objects.center_m).any()))


def _there(numbers: Array) -> Bool:
    there: Bool = ~np.all(np.isnan(numbers), axis=1)
    return there


def _are_finite(numbers: Array) -> Bool:
    finite: Bool = np.all(np.abs(numbers) < MAX_MAGNITUDE, axis=1)
    return finite


def _are_positive(sizes: Array) -> Bool:
    positive: Bool = np.all(sizes > 0, axis=1)
    return positive
