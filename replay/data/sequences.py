"""One sequence as it is scored: truth beside estimates, boxes as columns."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text, freeze_fields
from fbench.replay.data.boxes import MAX_MAGNITUDE, Rows

Space = Literal["2d", "3d", "both"]  # Where boxes are compared: in images, or in the ground plane and in space


@dataclass(frozen=True, eq=False)
class Objects(Rows):
    """N boxes of one side, truth or estimates, in the order of their steps; a field is `None` where nobody knows it. A
    box has a rectangle in an image, a solid in space, or both (KITTI's rows have both).
    """

    step: Int64
    """(N,) ascending index of the step (one frame, or one camera's image of a frame) that each box belongs to."""
    label: Text  # (N,) class in the words of the profile's source, lower case; empty where the class isn't known
    track_id: Int64  # (N,) negative where there is none
    score: Float64  # (N,) 0 where there is none
    xyxy_px: Float64 | None = None  # (N, 4) left, top, right, bottom [px]; NaN where there is none
    center_m: Float64 | None = None
    """(N, 3) middle of the solid [m], z up, in body or world coordinates, the same for both sides."""
    size_lwh_m: Float64 | None = None  # (N, 3) length along heading, width, height [m]
    yaw_rad: Float64 | None = None  # (N,) heading about z
    velocity_mps: Float64 | None = None  # (N, 3), NaN where unknown
    distance_m: Float64 | None = None  # (N,) from the body's origin, NaN where unknown
    range_rate_mps: Float64 | None = None  # (N,) change of distance, positive when receding; NaN where unknown
    alpha_rad: Float64 | None = None
    """(N,) angle at which the camera sees it, as KITTI's files have it; NaN where unknown."""
    occlusion: Float64 | None = None  # (N,) in the source's own levels; NaN where unknown
    truncation: Float64 | None = None  # (N,) in the source's own measure; NaN where unknown
    visibility: Float64 | None = None  # (N,) visible share, 0 to 1; NaN where unknown
    num_points: Int64 | None = None  # (N,) LiDAR and radar points in the box; negative where unknown
    attribute: Text | None = None
    sources: Array | None = None  # (N,) uint8, bits of `Source`
    ignore: Bool | None = None  # (N,) neither a hit nor a miss
    inside: Bool | None = None  # (N,) in the region of interest; `None`: everywhere is
    seen: Bool | None = None  # (N,) some sensor of the log sees it, or may; `None`: nobody tells
    predicted: Bool | None = None  # (N,) made by a tracker alone, nothing measured it; `None`: none is

    def __post_init__(self) -> None:
        one, three, text = ("f8", ("N",)), ("f8", ("N", 3)), ("U", ("N",))
        freeze_fields(
            self, step=("i8", ("N",)), label=text, track_id=("i8", ("N",)), score=one, xyxy_px=("f8", ("N", 4)),
            center_m=three, size_lwh_m=three, yaw_rad=one, velocity_mps=three, distance_m=one, range_rate_mps=one,
            alpha_rad=one, occlusion=one, truncation=one, visibility=one, num_points=("i8", ("N",)), attribute=text,
            sources=("u1", ("N",)), ignore=("?", ("N",)), inside=("?", ("N",)),
            seen=("?", ("N",)), predicted=("?", ("N",)),
        )  # fmt: skip
        if len(self.step) and (np.diff(self.step) < 0).any():
            raise DataError("Objects.step: expected ascending")

    def __len__(self) -> int:
        return len(self.step)

    def starts(self, num_steps: int) -> Int64:
        """Offsets (num_steps + 1,) of the rows of each step: step s has rows `starts[s]:starts[s + 1]`."""
        return np.searchsorted(self.step, np.arange(num_steps + 1)).astype(np.int64)


def are_finite(values: Float64) -> Bool:
    """Tell which rows (N,) of (N, K) numbers are finite, and not absurdly large."""
    return np.asarray((np.abs(values) < MAX_MAGNITUDE).all(axis=1))


@dataclass(frozen=True, eq=False)
class Steps:
    """S instants that are scored one by one: frames, or images of single cameras, in the order of time."""

    frame: Int64  # (S,) index of the frame in the log or sequence, for reports
    stamp_ns: Int64  # (S,) 0 where the source counts frames only
    stream: Int64
    """(S,) number of the stream, one after another in time: tracks go on within it, not into another. A segment of
    the log, and in images each camera of it, is a stream."""
    camera: tuple[str, ...] = ()  # Name of the camera of each step; empty where steps are whole frames

    def __post_init__(self) -> None:
        one = ("i8", ("S",))
        freeze_fields(self, frame=one, stamp_ns=one, stream=one)

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def places(self) -> Int64:
        """(S,) how many steps of its stream come before each step."""
        order = np.argsort(self.stream, kind="stable")
        sizes = np.unique(self.stream, return_counts=True)[1]
        place = np.empty(len(self), np.int64)
        place[order] = np.arange(len(self)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        return place

    @classmethod
    def of_one_stream(cls, num_frames: int) -> "Steps":
        """Return steps 0 to `num_frames` - 1 of one stream."""
        zeros = np.zeros(num_frames, np.int64)
        return cls(np.arange(num_frames), zeros, zeros)


@dataclass(frozen=True, eq=False)
class Sequence:
    """What one log, sequence or scene holds for one kind of results. Only labeled frames are there: those without truth
    are left out, and counted in `num_unlabeled`.
    """

    name: str  # As its source calls it: unique within an evaluation
    steps: Steps
    truth: Objects  # All of it: also what a profile excuses or leaves out
    estimates: Objects
    num_unlabeled: int = 0  # Frames with results, or of the run, that have no truth
    num_invalid_truth: int = 0  # Truth boxes that aren't finite or have no size; they aren't in `truth`
    tags: Mapping[str, str] = field(default_factory=dict)
    """Scenario, condition and other words that results can be split by."""
    ego_m: Array | None = None
    """(S, 3) where the body is at each step, in the coordinates of the boxes; `None`: at their origin."""
