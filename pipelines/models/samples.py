"""Images and truth of a training, and its settings."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from fbench.pipelines.models.settings import LoopSettings
from fbench.pipelines.sensors.camera.channels import NO_POINTS, ImagePoints
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog, StagedFaults
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo
from fbench.replay.setup.source import LogRequest, log_source

CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
"""Labels that the detector tells apart, in the order of its outputs."""
INPUT_WH = (640, 480)  # Width and height of the finished detector's input [px]


@dataclass(frozen=True)
class TrainingSettings(LoopSettings):
    """Parameters of a training; every `whole_every`-th batch is one of whole images."""

    steps: int = 10_000
    crops: int = 12  # Crops in a batch.
    crop_wh: tuple[int, int] = (320, 256)  # Size of a crop [px of the network's input].
    wholes: int = 3  # Whole images in a batch.
    whole_every: int = 5
    zoom: tuple[float, float] = (0.55, 1.4)
    """Range of the scale of a crop, times the scale of a whole image in the network's input; drawn evenly in log."""
    common: float = 0.4  # Classes that a smaller share of images show are drawn more often, see `rarity`.


@dataclass(frozen=True)
class RgbdSettings(TrainingSettings):
    """The same with points: in how large a share of the views which of them, or the image, is missing."""

    without_points: float = 0.15
    without_lidar: float = 0.12
    without_radar: float = 0.2
    without_image: float = 0.05
    thinned: float = 0.3  # Share of views from which many of LiDAR's points are dropped


@dataclass(frozen=True, eq=False)
class Sample:
    """One image and the N boxes in it."""

    name: str  # Log with its id, sensor and stamp
    image: Image
    xyxy: Float64  # (N, 4) left, top, right, bottom around whole bodies [px from the upper left corner]
    class_id: Int64  # (N,) index in `CLASSES`; -1 of what is neither to be found nor a mistake
    points: ImagePoints = NO_POINTS
    is_recorded: bool = False  # Not simulated

    @property
    def is_ignored(self) -> Bool:
        """(N,)."""
        return self.class_id < 0


def samples(logs: Sequence[Path], faults: FaultLog) -> list[Sample]:
    """Read all images of logs that have 2D truth at their stamps; JPEG stays encoded.

    Cameras in which a log has no truth at all are left out: nobody labeled them. Corrupt images, and what else is wrong
    with the data, are counted in `faults`. Raises LogError where there are none, or nothing in them is to be found.
    """
    return require_objects(gather(map(_of_log, logs), faults))


Made = TypeVar("Made")


def gather(parts: Iterable[tuple[Sequence[Made], StagedFaults]], faults: FaultLog) -> list[Made]:
    """Join the samples of logs, and count what was wrong with each."""
    found: list[Made] = []
    for part, own in parts:
        found += part
        own.pass_to(faults)
    return found


def can_decode(image: Image, path: Path, faults: FaultLog) -> bool:
    """Tell whether an image of a log can be decoded; one that can't be is counted."""
    if decode(image) is None:
        faults.add("DEC002", f"{path.name}: {image.sensor} at stamp {image.stamp_ns}")
        return False
    return True


def require_objects(found: list[Sample]) -> list[Sample]:
    """Return the samples. Raises LogError where there are none, or nothing is to be found in those of a kind of log."""
    if not found:
        raise LogError("no image with 2D truth in these logs: nothing to learn from")
    for where, own in by_kind(found):
        if all(sample.is_ignored.all() for sample in own):
            raise LogError(f"no box in {where} has one of the labels {', '.join(CLASSES)}: nothing to learn from")
    return found


class OfLog(Protocol):
    """A sample that knows what kind of log it is from."""

    @property
    def is_recorded(self) -> bool:
        """Not simulated."""
        ...


Known = TypeVar("Known", bound=OfLog)


def by_kind(found: Sequence[Known]) -> Iterator[tuple[str, Sequence[Known]]]:
    """Yield the samples of recordings and of simulated logs apart, as each gets its share, with what they are called;
    all at once where there is one kind.
    """
    kinds = [(name, [one for one in found if one.is_recorded == is_recorded])
             for name, is_recorded in (("the recordings", True), ("the simulated logs", False))]  # fmt: skip
    yield from kinds if all(own for _, own in kinds) else [("these logs", found)]


def _of_log(path: Path) -> tuple[list[Sample], StagedFaults]:
    faults, found = StagedFaults(), list[Sample]()
    log = log_source(LogRequest(path)).open(faults)
    truths = {truth.stamp_ns: truth.boxes2d for truth in log.truths() if truth.boxes2d is not None}
    labeled = {str(camera) for boxes in truths.values() for camera in boxes.camera}
    for message in log.messages():
        if not (isinstance(message, Image) and message.sensor in labeled and message.stamp_ns in truths):
            continue
        if can_decode(message, path, faults):
            found.append(make_sample(log.info, message, truths[message.stamp_ns], NO_POINTS))
    return found, faults


def make_sample(info: LogInfo, image: Image, truth: Boxes2D, points: ImagePoints) -> Sample:
    """Return an image of a log with the truth of all cameras at its stamp."""
    ids = np.full(len(truth), -1)
    if truth.label is not None:
        for index, label in enumerate(CLASSES):
            ids[truth.label == label] = index
    if truth.ignore is not None:
        ids[truth.ignore] = -1
    mine = truth.camera == image.sensor
    name = f"{info.name} {info.log_id} {image.sensor} {image.stamp_ns}"
    xyxy, is_recorded = truth.xyxy_px[mine] + 0.5, SIMULATED not in info.metadata
    return Sample(name, image, xyxy, ids[mine].astype(np.int64), points, is_recorded)


def rarity(samples: Sequence[Sample], common: float) -> Float64:
    """How many times as often objects of each class (C,) are drawn: sqrt(common / f) where a share f < common of the
    images shows one (repeat factor sampling; Gupta et al., LVIS, CVPR 2019).
    """
    shown = np.zeros(len(CLASSES))
    for sample in samples:
        shown[np.unique(sample.class_id[~sample.is_ignored])] += 1
    return np.asarray(np.sqrt(np.maximum(common * len(samples) / np.maximum(shown, 1), 1)), np.float64)
