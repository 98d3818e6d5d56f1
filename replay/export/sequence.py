"""The boxes of one run or log, as exporters see them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import MAX_MAGNITUDE, Boxes2D, Boxes3D, finite
from fbench.replay.data import Kind, Rig
from fbench.replay.errors import LogError
from fbench.replay.export.wish import LeftOut

B = TypeVar("B", Boxes2D, Boxes3D)


@dataclass(frozen=True, eq=False)
class BoxFrame:
    """One frame and the boxes in it; `None` where it has none of a kind, which isn't the same as nothing there."""

    index: int
    """Place among the frames of the log, from 0."""
    number: int | None
    """As the recorder or dataset numbers it."""
    stamp_ns: int
    rig: Rig
    boxes3d: Boxes3D | None
    """In body coordinates at the stamp."""
    boxes2d: Boxes2D | None
    world_T_body: Float64 | None = None
    """(4, 4) where known."""


@dataclass(frozen=True, eq=False)
class BoxSequence:
    """One run or log."""

    where: str
    """For errors."""
    name: str
    """For files."""
    metadata: Mapping[str, str]
    is_truth: bool
    frames: Sequence[BoxFrame]
    num_frames: int
    """Of the log up to the last one that is known, also those without truth."""
    kinds: Collection[Kind] = ()
    """Of the sensors that results come from."""

    @property
    def boxes(self) -> Sequence[Boxes2D | Boxes3D]:
        """Those of all frames, 3D ones first."""
        both = ((frame.boxes3d, frame.boxes2d) for frame in self.frames)
        return [boxes for pair in both for boxes in pair if boxes is not None and len(boxes)]

    @property
    def rig(self) -> Rig:
        """The sensors as it begins."""
        return self.frames[0].rig if self.frames else Rig({}, {})

    @cached_property
    def cameras_of_boxes(self) -> Sequence[str]:
        """Those in whose images there are 2D boxes, sorted."""
        flat = (frame.boxes2d.camera for frame in self.frames if frame.boxes2d is not None)
        return sorted({name for names in flat for name in names.tolist()})

    def numbers(self) -> list[int]:
        """Number of each frame: the log's own where every frame has one of its own, else its index."""
        own = [frame.number for frame in self.frames]
        known = [number for number in own if number is not None]
        return known if len(set(known)) == len(own) else [frame.index for frame in self.frames]

    def require_boxes(self, is_tracking: bool) -> None:
        """Refuse what has no boxes at all, or no ids where these are needed.

        Raises:
            LogError: saying what there is not.
        """
        kinds = [boxes for frame in self.frames for boxes in (frame.boxes3d, frame.boxes2d) if boxes is not None]
        if not kinds:
            raise LogError(f"{self.where}: has no {'truth' if self.is_truth else 'boxes'} to export")
        full = self.boxes
        if is_tracking and full and all(boxes.track_id is None for boxes in full):
            raise LogError(
                f"{self.where}: its boxes have no track ids, which this format needs; export tracks with --boxes "
                "tracks, or take --format kitti or nuscenes"
            )


def usable(boxes: B | None, left: LeftOut) -> B | None:
    """Return boxes without those whose geometry or score isn't finite, or beyond all reason, which are counted."""
    if boxes is None or not len(boxes):
        return boxes
    sane, scored = finite(boxes)
    good: Bool = sane & scored if boxes.score is None else sane & (np.abs(boxes.score) < MAX_MAGNITUDE)
    left.add("not finite", int(np.count_nonzero(~good)))
    return boxes if good.all() else boxes[good]
