"""YOLOv5, YOLOv8, YOLO11 and later exports: boxes decoded inside the model, in pixels of the input."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import ClassLabels
from fbench.pipelines.camera.layouts import Size, corners_of, select, usable
from fbench.pipelines.camera.placing import letterbox, place, planes
from fbench.replay.arrays import Array, Float64
from fbench.replay.images import Pixels

Head: TypeAlias = Literal["objectness", "classes", "final"]
"""What the rows hold: cx, cy, w, h, objectness, classes (YOLOv5: (B, N, 5 + classes)); cx, cy, w, h, classes
(YOLOv8 and later: (B, 4 + classes, N)); left, top, right, bottom, score, class (NMS inside the model: (B, N, 6))."""


@dataclass(frozen=True)
class Ultralytics:
    """Input (B, 3, H, W) RGB 0..1, letterboxed to the middle; one output, see `Head`."""

    image_input: str
    input_wh: Size
    head: Head
    labels: ClassLabels
    batch: int | None

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Letterbox each image to the middle of the input."""
        placed = [
            place(image, letterbox((image.shape[1], image.shape[0]), self.input_wh, centred=True), self.input_wh)
            for image in images
        ]
        return {self.image_input: planes(placed, rgb=True, unit=True)}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Move the boxes back to each image."""
        results = []
        for raw, size in zip(outputs[0], sizes_wh, strict=True):
            boxes = self._boxes(self._rows(raw, min_score), min_score)
            results.append(letterbox(size, self.input_wh, centred=True).back(boxes))
        return results

    def _rows(self, raw: Array, min_score: float) -> Float64:
        """Rows as `Head` says, a box each; where that is quickly told, only of those that score enough, mostly few."""
        if self.head != "classes":
            return np.asarray(raw, np.float64)
        likely = np.asarray(raw[4:].max(axis=0), np.float64) >= min_score
        return np.asarray(raw[:, likely].T, np.float64)

    def _boxes(self, rows: Float64, min_score: float) -> Candidates:
        rows = rows[usable(rows)]
        if self.head == "final":
            return select(rows[:, :4], rows[:, 4], np.rint(rows[:, 5]), self.labels, min_score)
        class_scores = rows[:, 5:] * rows[:, 4:5] if self.head == "objectness" else rows[:, 4:]
        class_id = np.argmax(class_scores, axis=1)
        score = np.take_along_axis(class_scores, class_id[:, None], axis=1)[:, 0]
        return select(corners_of(rows), score, class_id, self.labels, min_score)
