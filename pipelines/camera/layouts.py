"""The contract of a model family: what goes in, and how to read what comes out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import ClassLabels, translate
from fbench.replay.arrays import Array
from fbench.replay.images import Pixels

Size = tuple[int, int]


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
    def max_batch(self) -> int | None:
        """How many images fit into one call; `None`: any number."""
        ...

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Fit images (H, W, 3) BGR into the model's inputs."""
        ...

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Boxes of each image with at least `min_score`, in pixels from that image's upper left corner."""
        ...


def select(xyxy: Array, score: Array, class_id: Array, labels: ClassLabels, min_score: float) -> Candidates:
    """Keep finite boxes (N, 4) with a known class (N,) and enough score (N,)."""
    text, known = translate(np.asarray(class_id, np.int64), labels)
    boxes, scores = np.asarray(xyxy, np.float64), np.asarray(score, np.float64)
    keep = known & (scores >= min_score) & np.isfinite(boxes).all(axis=1)
    return Candidates(boxes[keep], scores[keep], text[keep])


def corners_of(cxcywh: Array) -> Array:
    """Turn centre and size (N, 4) into left, top, right, bottom."""
    centre, half = cxcywh[:, :2], cxcywh[:, 2:4] / 2
    return np.concatenate([centre - half, centre + half], axis=1)
