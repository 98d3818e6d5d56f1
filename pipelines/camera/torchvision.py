"""torchvision detection exports (Faster R-CNN, FCOS, RetinaNet, SSD): the model scales, normalises and does NMS."""

from collections.abc import Sequence
from dataclasses import dataclass

from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.classes import ClassLabels
from fbench.pipelines.camera.layouts import Size, select
from fbench.pipelines.camera.placing import place, planes, squash
from fbench.replay.arrays import Array
from fbench.replay.images import Pixels


@dataclass(frozen=True)
class Torchvision:
    """Input (3, H, W) or (1, 3, H, W) RGB 0..1; outputs boxes (N, 4) in input pixels, labels (N,), scores (N,)."""

    image_input: str
    input_wh: Size | None
    """`None`: any size, images are fed as they are."""
    batch_axis: bool
    output_order: tuple[int, int, int]
    """Where labels, boxes and scores stand among the outputs."""
    labels: ClassLabels
    batch: int = 1

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Feed one image, squashed only where the model's input has a fixed size."""
        image = images[0]
        size = (image.shape[1], image.shape[0])
        wanted = self.input_wh or size
        fitted = image if size == wanted else place(image, squash(size, wanted), wanted)
        values = planes([fitted], rgb=True, unit=True)
        return {self.image_input: values if self.batch_axis else values[0]}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Move the boxes back to the image."""
        label, xyxy, score = (outputs[i] for i in self.output_order)
        boxes = select(xyxy, score, label, self.labels, min_score)
        return [squash(sizes_wh[0], self.input_wh or sizes_wh[0]).back(boxes)]
