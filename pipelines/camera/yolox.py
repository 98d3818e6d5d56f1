"""YOLOX exports: one anchor a cell, boxes relative to the grid, objectness times class."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import ClassLabels
from fbench.pipelines.camera.layouts import Size, corners_of, select, usable
from fbench.pipelines.camera.placing import letterbox, place, planes
from fbench.replay.arrays import Array, Float64
from fbench.replay.images import Pixels


@dataclass(frozen=True)
class YoloX:
    """Input (B, 3, H, W) BGR 0..255, letterboxed to the upper left; output (B, cells, 5 + classes)."""

    image_input: str
    input_wh: Size
    strides: tuple[int, ...]
    labels: ClassLabels
    batch: int | None

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Letterbox each image to the upper left corner of the input."""
        placed = [
            place(image, letterbox((image.shape[1], image.shape[0]), self.input_wh, centred=False), self.input_wh)
            for image in images
        ]
        return {self.image_input: planes(placed, rgb=False, unit=False)}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Decode the grid and move the boxes back to each image."""
        cells = grid(self.input_wh, self.strides)
        results = []
        for raw, size in zip(outputs[0], sizes_wh, strict=True):
            boxes = self._boxes(np.asarray(raw, np.float64), cells, min_score)
            results.append(letterbox(size, self.input_wh, centred=False).back(boxes))
        return results

    def _boxes(self, raw: Float64, cells: Float64, min_score: float) -> Candidates:
        decoded = is_decoded(raw, self.input_wh)
        likely = usable(raw) & (raw[:, 4] >= min_score)
        raw, cells = raw[likely], cells[likely]
        xyxy = corners_of(raw if decoded else decode_grid(raw[:, :4], cells))
        class_id = np.argmax(raw[:, 5:], axis=1)
        score = raw[:, 4] * np.take_along_axis(raw[:, 5:], class_id[:, None], axis=1)[:, 0]
        return select(xyxy, score, class_id, self.labels, min_score)


def is_decoded(raw: Float64, input_wh: Size) -> bool:
    """Tell whether the export did the grid's arithmetic itself (YOLOX's `--decode_in_inference`).

    Centres then reach all parts of the input, while plain outputs stay within a few cells.
    """
    return bool((raw[:, :2].max(axis=0) > np.array(input_wh) / 2).all())


def grid(input_wh: Size, strides: tuple[int, ...]) -> Float64:
    """Column, row and stride (cells, 3) of every cell, row by row, level by level."""
    levels = []
    for stride in strides:
        rows, columns = np.mgrid[0 : input_wh[1] // stride, 0 : input_wh[0] // stride]
        levels.append(np.stack([columns.ravel(), rows.ravel(), np.full(rows.size, stride)], axis=1))
    return np.concatenate(levels).astype(np.float64)


def decode_grid(raw: Float64, cells: Float64) -> Float64:
    """Centre and size (N, 4) [input px]: (offset + cell) * stride, exp(size) * stride (YOLOX, arXiv 2107.08430)."""
    stride = cells[:, 2:3]
    # An exponent of 20 is far beyond any image; more would overflow on damaged weights.
    size = np.exp(np.minimum(raw[:, 2:4], 20.0)) * stride
    return np.concatenate([(raw[:, :2] + cells[:, :2]) * stride, size], axis=1)
