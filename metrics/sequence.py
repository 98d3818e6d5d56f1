"""One log or sequence as it is scored: truth beside estimates, whatever files or run they come from."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array, Int64, freeze_fields


@dataclass(frozen=True, eq=False)
class Steps:
    """S instants that are scored one by one: frames, or images of single cameras, in the order of time."""

    frame: Int64
    """(S,) index of the frame in the log or sequence, for reports."""
    stamp_ns: Int64
    """(S,) 0 where the source counts frames only."""
    stream: Int64
    """(S,) number of the stream, one after another in time: tracks go on within it, not into another. A segment of
    the log, and in images each camera of it, is a stream."""
    camera: tuple[str, ...] = ()
    """Name of the camera of each step; empty where steps are whole frames."""

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
    def counted(cls, num_frames: int) -> "Steps":
        """Return steps 0 to `num_frames` - 1 of one stream."""
        zeros = np.zeros(num_frames, np.int64)
        return cls(np.arange(num_frames), zeros, zeros)


@dataclass(frozen=True, eq=False)
class Sequence:
    """What one log, sequence or scene holds for one kind of results.

    Only labelled frames are there: those without truth are left out, and counted in `num_unlabelled`.
    """

    name: str
    """As its source calls it: unique within an evaluation."""
    steps: Steps
    truth: Objects
    """All of it: also what a profile excuses or leaves out."""
    estimates: Objects
    num_unlabelled: int = 0
    """Frames with results, or of the run, that have no truth."""
    num_invalid_truth: int = 0
    """Truth boxes that aren't finite or have no size; they aren't in `truth`."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Scenario, condition and other words that results can be split by."""
    ego_m: Array | None = None
    """(S, 3) where the body is at each step, in the coordinates of the boxes; `None`: at their origin."""
