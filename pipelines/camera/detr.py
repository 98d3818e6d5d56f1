"""DEIMv2, D-FINE and RT-DETR exports: no anchors, no NMS, boxes in pixels of the source image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import ClassLabels
from fbench.pipelines.camera.layouts import Size, select
from fbench.pipelines.camera.placing import place, planes, squash
from fbench.replay.arrays import Array
from fbench.replay.images import Pixels


@dataclass(frozen=True)
class Detr:
    """Inputs `images` (B, 3, H, W) RGB 0..1, squashed, and `orig_target_sizes` (B, 2) width, height.

    Outputs `labels` (B, N), `boxes` (B, N, 4) left, top, right, bottom, `scores` (B, N).
    """

    image_input: str
    size_input: str
    output_order: tuple[int, int, int]
    """Where labels, boxes and scores stand among the outputs."""
    input_wh: Size
    labels: ClassLabels
    batch: int | None

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Squash each image into the input, whatever its aspect ratio."""
        sizes = [(image.shape[1], image.shape[0]) for image in images]
        placed = [
            place(image, squash(size, self.input_wh), self.input_wh) for image, size in zip(images, sizes, strict=True)
        ]
        return {
            self.image_input: planes(placed, rgb=True, unit=True),
            self.size_input: np.array(sizes, np.int64).reshape(-1, 2),
        }

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Take the boxes as they are: they are in pixels of the source already."""
        label, xyxy, score = (outputs[i] for i in self.output_order)
        return [select(xyxy[i], score[i], label[i], self.labels, min_score) for i in range(len(sizes_wh))]
