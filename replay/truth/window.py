"""The truths around the one that is looked at."""

from collections.abc import Iterator
from dataclasses import dataclass

from fbench.replay.boxes import Boxes2D
from fbench.replay.data import Truth


@dataclass(eq=False)
class Placed:
    """A truth with its frame."""

    truth: Truth
    index: int | None
    is_source: bool
    """Whether its stamp is of the clock of the frames, so that others can be interpolated with it."""
    is_used: bool = False
    """Whether a frame between truths got boxes from it."""

    @property
    def stamp_ns(self) -> int:
        """Its stamp."""
        return self.truth.stamp_ns


class Window:
    """Truths by stamp, each given out when all that are less than `reach_ns` later are known, and kept until none is
    looked at that is less than that later.
    """

    def __init__(self, reach_ns: int) -> None:
        self._reach_ns = reach_ns
        self._placed: list[Placed] = []
        self._num_done = 0

    def goes_back(self, truth: Truth) -> bool:
        """Whether a truth comes from a clock that was set back."""
        return bool(self._placed) and truth.stamp_ns < self._placed[-1].stamp_ns

    def add(self, placed: Placed) -> None:
        """Take the next truth."""
        self._placed.append(placed)

    def settled(self) -> Iterator[tuple[Placed, Placed | None]]:
        """Give out truths whose surroundings are known, each with the next one, and forget what is too old."""
        settled_ns = self._placed[-1].stamp_ns - self._reach_ns if self._placed else 0
        while self._num_done < len(self._placed) and self._placed[self._num_done].stamp_ns < settled_ns:
            yield self._give()
        old = sum(placed.stamp_ns < settled_ns - self._reach_ns for placed in self._placed[: self._num_done])
        del self._placed[:old]
        self._num_done -= old

    def rest(self) -> Iterator[tuple[Placed, Placed | None]]:
        """Give out all others, and begin anew."""
        while self._num_done < len(self._placed):
            yield self._give()
        self._placed, self._num_done = [], 0

    def _give(self) -> tuple[Placed, Placed | None]:
        self._num_done += 1
        return self._placed[self._num_done - 1], next(iter(self._placed[self._num_done :]), None)

    def before(self, stamp_ns: int, camera: str | None) -> Placed | None:
        """The last truth up to a stamp that labels a camera, or 3D boxes where that is `None`."""
        found = (p for p in reversed(self._placed) if p.stamp_ns <= stamp_ns)
        return next((p for p in found if self._labels(p, camera)), None)

    def after(self, stamp_ns: int, camera: str | None) -> Placed | None:
        """The first truth from a stamp on that labels a camera, or 3D boxes where that is `None`."""
        found = (p for p in self._placed if p.stamp_ns >= stamp_ns)
        return next((p for p in found if self._labels(p, camera)), None)

    def cameras(self, first_ns: int, last_ns: int) -> list[str]:
        """Those with boxes from one stamp to another."""
        near = [p.truth.boxes2d for p in self._placed if first_ns <= p.stamp_ns <= last_ns]
        return sorted({camera for boxes in near if boxes is not None for camera in boxes.camera.tolist()})

    def _labels(self, placed: Placed, camera: str | None) -> bool:
        """Whether a truth tells what was there. One without boxes of a camera says that nothing was, unless another
        truth of the same frame complements it.
        """
        if camera is None or placed.truth.boxes2d is None or not placed.is_source:
            return placed.is_source and camera is None and placed.truth.boxes3d is not None
        if placed.index is None or len(flat(placed.truth, camera)):
            return True
        return not any(p.index == placed.index and len(flat(p.truth, camera)) for p in self._placed)


def flat(truth: Truth, camera: str) -> Boxes2D:
    """The boxes of a camera."""
    boxes = Boxes2D.empty() if truth.boxes2d is None else truth.boxes2d
    return boxes[boxes.camera == camera]
