"""What a model proposes for one image, before anything is merged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64, Text


@dataclass(frozen=True, eq=False)
class Candidates:
    """N boxes of one image.

    Coordinates here are distances from the image's upper left corner, so that the image spans 0 to width and
    scaling an image scales its boxes.
    """

    xyxy: Float64
    """(N, 4) left, top, right, bottom [px]."""
    score: Float64
    """(N,) 0 to 1."""
    label: Text
    """(N,) of `LABELS`."""

    def __len__(self) -> int:
        return len(self.score)

    def rows(self, rows: np.ndarray) -> "Candidates":
        """Select rows by mask or index array."""
        return Candidates(self.xyxy[rows], self.score[rows], self.label[rows])

    def moved(self, scale: tuple[float, float], offset: tuple[float, float]) -> "Candidates":
        """Return the boxes at scale * (x, y) + offset."""
        xyxy = self.xyxy * (scale * 2) + np.array(offset * 2)
        return Candidates(xyxy, self.score, self.label)

    def clipped(self, size_wh: tuple[int, int]) -> "Candidates":
        """Cut boxes at the image's border and drop those that are empty or not finite."""
        xyxy = np.clip(self.xyxy, 0.0, np.array(size_wh * 2, np.float64))
        whole = (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1]) & np.isfinite(self.score)
        return Candidates(xyxy, self.score, self.label).rows(whole)

    def ordered(self) -> "Candidates":
        """Sort by falling score; equal scores by box, then label, so that the order is always the same."""
        keys = (self.label, *self.xyxy.T[::-1], -self.score)
        return self.rows(np.lexsort(keys))


def join(parts: Sequence[Candidates]) -> Candidates:
    """Put the candidates of several images into one list."""
    if not parts:
        return Candidates(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U1"))
    return Candidates(
        np.concatenate([p.xyxy for p in parts]),
        np.concatenate([p.score for p in parts]),
        np.concatenate([p.label for p in parts]),
    )
