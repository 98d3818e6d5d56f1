"""Assignment of truth to frames, fit to be scored."""

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import MAX_BOXES, Boxes2D, Boxes3D, concatenate, finite, most_boxes
from fbench.replay.data.messages import Truth
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse

LabeledBoxes = TypeVar("LabeledBoxes", Boxes2D, Boxes3D)

TOLERANCE_NS = 10_000_000  # Truth without a frame number belongs to the nearest frame not farther away than this


@dataclass(frozen=True, slots=True)
class Instant:
    """A frame that was opened, chosen or not."""

    index: int
    stamp_ns: int  # Of the reference's message as recorded, which truth refers to
    frame_number: int | None
    is_chosen: bool
    segment: int = 0


class Labelling:
    """Finds the frame of each truth, among all frames or some: by frame number where both have one, else by nearest
    stamp.

    Numbers may start again in another segment: of several frames of one number the one with the nearest stamp is meant.
    Truth of a file that counts frames has no stamp to tell: its numbers are those of the log where each is there once,
    else indices. It gets its frame's stamp.
    """

    def __init__(self, instants: Sequence[Instant]) -> None:
        self.instants = {instant.index: instant for instant in instants}
        self._by_stamp = sorted(instants, key=lambda instant: instant.stamp_ns)
        self._stamps = [instant.stamp_ns for instant in self._by_stamp]
        self._by_number: dict[int, list[Instant]] = {}
        for instant in instants:
            if instant.frame_number is not None:
                self._by_number.setdefault(instant.frame_number, []).append(instant)
        self._is_numbered = bool(self._by_number) and all(len(same) == 1 for same in self._by_number.values())

    def frame_of(self, truth: Truth) -> int | None:
        """Index of the frame, or `None` where there is none."""
        index, number = truth.frame_index, truth.frame_number
        if index is not None and (number is None or not self._is_numbered):
            return index if index in self.instants else None
        if number is not None and self._by_number:
            candidates = self._by_number.get(number, [])
        else:
            candidates = [self.instants[near] for near in self.around(truth.stamp_ns)]
            candidates = [near for near in candidates if abs(near.stamp_ns - truth.stamp_ns) <= TOLERANCE_NS]
        distances = [(abs(instant.stamp_ns - truth.stamp_ns), instant.index) for instant in candidates]
        return min(distances)[1] if distances else None

    def distance_ns(self, index: int, truth: Truth) -> int:
        """How far the stamps of a frame and a truth are apart."""
        return abs(self.instants[index].stamp_ns - truth.stamp_ns)

    def between(self, first_ns: int, last_ns: int) -> list[int]:
        """Indices of the frames from one stamp to another, both included, in the order of their stamps."""
        start, stop = bisect_left(self._stamps, first_ns), bisect_right(self._stamps, last_ns)
        return [instant.index for instant in self._by_stamp[start:stop]]

    def around(self, stamp_ns: int) -> list[int]:
        """Indices of the last frame before a stamp and the first one from there on, as far as there are any."""
        at = bisect_left(self._stamps, stamp_ns)
        return [instant.index for instant in self._by_stamp[max(0, at - 1) : at + 1]]

    def match(self, truths: Iterator[Truth]) -> Iterator[tuple[int | None, Truth]]:
        """Yield every truth with its frame. Several truths of one frame are joined where they complement each other (3D
        and 2D, or different cameras); else the nearest gets it, and others get `None`.

        Truths come by stamp, so those of one frame follow each other and only one needs to be kept.
        """
        kept: tuple[int, Truth] | None = None
        done: dict[int, None] = {}
        for index, truth in map(self.locate, truths):
            if index is None or index in done:
                yield None, truth
            elif kept is not None and kept[0] == index:
                nearer, farther = sorted((kept, (index, truth)), key=lambda pair: self.distance_ns(*pair))
                both = join_truths(nearer[1], farther[1])
                kept = nearer if both is None else (index, both)
                if both is None:
                    yield None, farther[1]
            else:
                if kept is not None:
                    done[kept[0]] = None
                    yield kept
                kept = (index, truth)
        if kept is not None:
            yield kept

    def locate(self, truth: Truth) -> tuple[int | None, Truth]:
        """Return the frame of a truth, and the truth; what counts frames gets the frame's stamp."""
        index = self.frame_of(truth)
        if index is None or truth.frame_index is None:
            return index, truth
        return index, replace(truth, stamp_ns=self.instants[index].stamp_ns)


def stray(truth: Truth) -> str:
    """Name truth that belongs to no frame."""
    return f"truth at {truth.stamp_ns} ns" if truth.frame_index is None else f"truth of frame {truth.frame_index}"


def join_truths(nearer: Truth, farther: Truth) -> Truth | None:
    """What both say of one frame, with the stamp of the first; `None` where both label the same."""
    boxes2d = [boxes for boxes in (nearer.boxes2d, farther.boxes2d) if boxes is not None]
    boxes3d = [boxes for boxes in (nearer.boxes3d, farther.boxes3d) if boxes is not None]
    if len(boxes3d) > 1 or (len(boxes2d) > 1 and np.isin(boxes2d[0].camera, boxes2d[1].camera).any()):
        return None
    return replace(
        nearer,
        boxes3d=boxes3d[0] if boxes3d else None,
        boxes2d=concatenate(drop_unshared(boxes2d)) if boxes2d else None,
    )


def drop_unshared(parts: list[LabeledBoxes]) -> list[LabeledBoxes]:
    """Drop what only some of the parts tell: ids, say."""
    full = [part for part in parts if len(part)]
    names = (f.name for part in full for f in fields(part))
    unshared: dict[str, Any] = {name: None for name in names if any(getattr(part, name) is None for part in full)}
    return [replace(part, **unshared) if len(part) else part for part in parts]


def drop_invalid(
    truth: Truth, index: int, world_T_body: Float64 | None, has_poses: bool, faults: FaultLog
) -> Truth | None:
    """Return the truth of frame `index` without boxes that aren't finite or have no size, which are counted as GT004;
    those in the world are moved to the body by its pose (4, 4). `None` where that isn't known at this frame alone,
    counted as GT006, and where there are more boxes than `MAX_BOXES`, counted as GT008. Raises LogError where boxes are
    in the world and no frame has a pose.
    """
    most = max((most_boxes(boxes) for boxes in (truth.boxes3d, truth.boxes2d) if boxes is not None), default=0)
    if most > MAX_BOXES:
        faults.add("GT008", f"frame {index}: {most} boxes, more than {MAX_BOXES}")
        return None
    boxes3d = None if truth.boxes3d is None else _drop_unreal(truth.boxes3d, index, faults)
    if boxes3d is not None and truth.in_world and len(boxes3d):
        if not has_poses:
            what = "truth is in world coordinates, but the log has no poses of the body at its frames"
            raise LogError(f"{what}; give boxes in body coordinates, or a log with poses")
        if world_T_body is None:
            faults.add("GT006", f"truth of frame {index} in the world, where the log has no pose")
            return None
        boxes3d = move_boxes(boxes3d, inverse(world_T_body))
    boxes2d = None if truth.boxes2d is None else _drop_unreal(truth.boxes2d, index, faults)
    return replace(truth, boxes3d=boxes3d, boxes2d=boxes2d, in_world=False)


def is_real(boxes: Boxes2D | Boxes3D) -> Bool:
    """Tell which boxes (N,) are finite and have a size."""
    sane, _ = finite(boxes)
    sizes = boxes.size_lwh_m if isinstance(boxes, Boxes3D) else boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2]
    real: Bool = sane & np.all(sizes > 0, axis=1)
    return real


def _drop_unreal(boxes: LabeledBoxes, index: int, faults: FaultLog) -> LabeledBoxes:
    real = is_real(boxes)
    if real.all():
        return boxes
    names = boxes.source_label if boxes.source_label is not None else boxes.label
    labels = Counter([""] * int((~real).sum()) if names is None else names[~real].tolist())
    for name, num in sorted(labels.items()):
        faults.add("GT004", f"frame {index}: {num} of class '{name}'" if name else f"frame {index}: {num}", num)
    return boxes[real]
