"""The camera detector: one image in, labelled boxes out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fbench.pipelines.camera.layouts import SIDE_PX, Size
from fbench.pipelines.camera.merging import Window, merge, to_image, windows
from fbench.pipelines.camera.model import Batch, Model
from fbench.pipelines.camera.thresholds import thresholds
from fbench.pipelines.checks import require_between
from fbench.pipelines.weights.named import AUTO, Weights, resolve
from fbench.replay.arrays import Float64, Text, freeze_fields
from fbench.replay.errors import ConfigError, ModelError
from fbench.replay.images import Pixels
from fbench.replay.threads import num_threads

_THRESHOLDS = ("min_score", "nms_iou", "nms_containment")


@dataclass(frozen=True)
class CameraParams:
    """Parameters of the camera detector."""

    weights: Weights = AUTO
    """An ONNX file, or a name of `fbench weights list`; `auto` is fbench's own on simulated logs, and on others none;
    with `none` the camera isn't used.
    """
    min_score: float | None = None
    """Boxes with a lower score are dropped. Unless set, this and the next two are what the weights' metadata say under
    these names, else 0.6, 0.5 and 0.9.
    """
    nms_iou: float | None = None
    """Of two boxes of one group that overlap more than this, the one with the higher score stays."""
    nms_containment: float | None = None
    """The same for a box of which more than this share lies inside the other."""
    tiles: bool = True
    """Look also at overlapping windows of very wide or tall images, since far objects vanish when these are shrunk."""
    tile_aspect: float = 2.0
    """Longer by shorter side of such a window; images up to this aspect are looked at as a whole only."""
    tile_overlap: float = 0.1
    """Least share of a window by which neighbours overlap."""
    input_wh: tuple[int, int] | None = None
    """Width and height of the model's input [px], for models that leave it free."""
    threads: int = 2
    """Threads of onnxruntime at most, and no more than there are processors; results are the same for any number."""

    def __post_init__(self) -> None:
        for name in _THRESHOLDS:
            if getattr(self, name) is not None:
                require_between(f"camera.{name}", getattr(self, name), 0.0, 1.0)
        require_between("camera.tile_aspect", self.tile_aspect, 1.0)
        require_between("camera.tile_overlap", self.tile_overlap, 0.0, 0.9)
        require_between("camera.threads", self.threads, 1)
        for side in self.input_wh or ():
            require_between("camera.input_wh", side, *SIDE_PX)
        object.__setattr__(self, "weights", resolve(self.weights))


@dataclass(frozen=True, eq=False)
class CameraDetections:
    """N boxes of one image, by falling score."""

    xyxy_px: Float64
    """(N, 4) left, top, right, bottom [px]; pixel centres at integers."""
    score: Float64
    """(N,) 0 to 1."""
    label: Text
    """(N,) of `LABELS`."""
    min_score: float = 0.0
    """Boxes from this score on are reported by a camera alone; those below are for others to confirm."""

    def __post_init__(self) -> None:
        freeze_fields(self, xyxy_px=("f8", ("N", 4)), score=("f8", ("N",)), label=("U", ("N",)))

    def __len__(self) -> int:
        return len(self.score)


@dataclass(frozen=True, eq=False)
class Prepared:
    """An image, cut and scaled for the model."""

    size_wh: Size
    windows: Sequence[Window]
    batches: Sequence[Batch]


class CameraDetector:
    """Finds road users in images with one ONNX model.

    Raises:
        ConfigError: where no weights are named, or the file is missing.
        ModelError: where the weights can't be used.
    """

    def __init__(self, params: CameraParams) -> None:
        if not isinstance(params.weights, Path):
            raise ConfigError("the camera needs a detector: --set camera.weights=PATH (an ONNX file)")
        self._params = params
        self._model = Model(params.weights, min(params.threads, num_threads()), params.input_wh)
        asked = {name: getattr(params, name) for name in _THRESHOLDS}
        try:
            self._thresholds = thresholds(asked, self._model.metadata)
        except ModelError as error:
            raise ModelError(f"{params.weights}: {error}") from error

    def prepare(self, pixels: Pixels) -> Prepared:
        """Cut and scale an image (H, W, 3) BGR."""
        size = (pixels.shape[1], pixels.shape[0])
        wide = self._params.tile_aspect if self._params.tiles else math.inf
        parts = windows(size, wide, self._params.tile_overlap)
        images = [pixels[top:bottom, left:right] for left, top, right, bottom in parts]
        return Prepared(size, parts, self._model.batches(images))

    def infer(self, prepared: Prepared, share: float = 1.0) -> CameraDetections:
        """Run the model and merge what it found, down to this share of the score from which on boxes are reported.

        Raises:
            ModelError: where the model fails, or its outputs aren't as its header says.
        """
        least = share * self._thresholds.min_score
        found = [boxes for batch in prepared.batches for boxes in self._model.run(batch, least)]
        parts = [
            to_image(boxes, window, prepared.size_wh) for boxes, window in zip(found, prepared.windows, strict=True)
        ]
        merged = merge(parts, self._thresholds.nms_iou, self._thresholds.nms_containment)
        return CameraDetections(merged.xyxy - 0.5, merged.score, merged.label, self._thresholds.min_score)
