"""The contract of a model family: what goes in, and how to read what comes out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import MAX_CLASS, ClassLabels, translate
from fbench.replay.arrays import Array, Bool
from fbench.replay.images import Pixels

Size = tuple[int, int]

SIDE_PX = (32, 8192)
"""Shortest and longest side of an input that is believed."""
_MAX_PX = 1e12


@dataclass(frozen=True)
class Port:
    """One input or output of a model, as its header describes it."""

    name: str
    dtype: str
    """As onnxruntime writes it, for example `tensor(float)`."""
    shape: tuple[int | None, ...]
    """`None` where the header leaves the size free."""


@dataclass(frozen=True)
class ModelHeader:
    """What a model says about itself."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    metadata: Mapping[str, str]


class Layout(Protocol):
    """One family of models."""

    @property
    def batch(self) -> int | None:
        """How many images each call takes; `None`: the header leaves it free."""
        ...

    @property
    def input_wh(self) -> Size | None:
        """Width and height of the input [px]; `None`: any."""
        ...

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Fit images (H, W, 3) BGR into the model's inputs."""
        ...

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Boxes of each image with at least `min_score`, in pixels from that image's upper left corner."""
        ...


def select(xyxy: Array, score: Array, class_id: Array, labels: ClassLabels, min_score: float) -> Candidates:
    """Keep finite boxes (N, 4) with a known class (N,) and enough score (N,)."""
    ids = np.nan_to_num(class_id, nan=-1.0)
    text, known = translate(np.where(np.abs(ids) <= MAX_CLASS, ids, -1).astype(np.int64), labels)
    boxes, scores = np.asarray(xyxy, np.float64), np.asarray(score, np.float64)
    keep = known & (scores >= min_score) & np.isfinite(scores) & usable(boxes)
    return Candidates(boxes[keep], scores[keep], text[keep])


def usable(rows: Array) -> Bool:
    """Tell which rows (N, M) hold numbers with which the arithmetic of boxes neither overflows nor gives NaN."""
    magnitude = np.abs(np.nan_to_num(rows, nan=np.inf))
    return np.asarray((magnitude < _MAX_PX).all(axis=1), np.bool_)


def corners_of(cxcywh: Array) -> Array:
    """Turn centre and size (N, 4) into left, top, right, bottom."""
    centre, half = cxcywh[:, :2], cxcywh[:, 2:4] / 2
    return np.concatenate([centre - half, centre + half], axis=1)
