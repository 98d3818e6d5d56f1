"""Images with what is true of them, from logs, and the settings of a training."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.messages import Image
from fbench.replay.logs.open import open_log

CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
"""Labels that the detector tells apart, in the order of its outputs."""
INPUT_WH = (640, 480)  # Width and height of the finished detector's input [px]


@dataclass(frozen=True)
class TrainingSettings:
    """Parameters of a training."""

    seed: int = 1
    steps: int = 8000  # Batches; every `whole_every`-th is one of whole images.
    crops: int = 12  # Crops in a batch.
    crop_wh: tuple[int, int] = (320, 256)  # Size of a crop [px of the network's input].
    wholes: int = 3  # Whole images in a batch.
    whole_every: int = 5
    zoom: tuple[float, float] = (0.55, 1.4)
    """Range of the scale of a crop, times the scale of a whole image in the network's input; drawn evenly in log."""
    learning_rate: float = 4.0e-3
    warm_up: int = 150  # Steps over which the learning rate rises.
    weight_decay: float = 0.02
    average: float = 0.9985  # How much of the averaged weights each step keeps; these are the ones that are exported.
    checkpoint_every: int = 100  # Steps.


@dataclass(frozen=True, eq=False)
class Sample:
    """One image and the N boxes in it."""

    name: str  # Log with its id, sensor and stamp
    image: Image
    xyxy: Float64  # (N, 4) left, top, right, bottom around whole bodies [px from the upper left corner]
    class_id: Int64  # (N,) index in `CLASSES`; -1 of what is neither to be found nor a mistake

    @property
    def is_ignored(self) -> Bool:
        """(N,)."""
        ignored: Bool = self.class_id < 0
        return ignored


def samples(logs: Sequence[Path]) -> list[Sample]:
    """Read all images of logs that have 2D truth at their stamps; JPEG stays encoded.

    Cameras in which a log has no truth at all are left out: nobody labeled them. Raises LogError where there are none,
    or nothing in them is to be found.
    """
    found = [sample for path in logs for sample in _of_log(path)]
    if not found:
        raise LogError("no image with 2D truth in these logs: nothing to learn from")
    if all(sample.is_ignored.all() for sample in found):
        raise LogError(f"no box in these logs has one of the labels {', '.join(CLASSES)}: nothing to learn from")
    return found


def _of_log(path: Path) -> Iterator[Sample]:
    log = open_log(path, FaultLog())
    truths = {truth.stamp_ns: truth.boxes2d for truth in log.truths() if truth.boxes2d is not None}
    labeled = {str(camera) for boxes in truths.values() for camera in boxes.camera}
    for message in log.messages():
        if isinstance(message, Image) and message.sensor in labeled and message.stamp_ns in truths:
            yield _sample(f"{log.info.name} {log.info.log_id}", message, truths[message.stamp_ns])


def _sample(log: str, image: Image, truth: Boxes2D) -> Sample:
    mine = truth.camera == image.sensor
    ids = np.full(len(truth), -1)
    if truth.label is not None:
        for index, label in enumerate(CLASSES):
            ids[truth.label == label] = index
    if truth.ignore is not None:
        ids[truth.ignore] = -1
    name = f"{log} {image.sensor} {image.stamp_ns}"
    return Sample(name, image, truth.xyxy_px[mine] + 0.5, ids[mine].astype(np.int64))
