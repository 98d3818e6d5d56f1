"""Opening a file or folder of boxes, whatever form it is in."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.boxfiles.kitti import open_ab3dmot, open_kitti, open_kitti_tracking
from fbench.replay.boxfiles.mot import open_mot
from fbench.replay.boxfiles.nuscenes import open_nuscenes
from fbench.replay.boxfiles.openlabel import open_openlabel
from fbench.replay.boxfiles.recognise import recognised
from fbench.replay.boxfiles.table import open_table
from fbench.replay.data import Truth
from fbench.replay.errors import ConfigError, DataError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource
from fbench.replay.names import did_you_mean

FORMATS: Mapping[str, Callable[[BoxSource, CoordinateFrames, FaultLog], Iterator[Truth]]] = {
    "table": open_table,
    "kitti": open_kitti,
    "kitti-tracking": open_kitti_tracking,
    "ab3dmot": open_ab3dmot,
    "mot": open_mot,
    "nuscenes": open_nuscenes,
    "openlabel": open_openlabel,
}


@dataclass(frozen=True)
class BoxFile:
    """Boxes of a file, or of the files of a folder."""

    source: BoxSource
    format: str
    """One of `FORMATS`."""
    coordinates: CoordinateFrames
    faults: FaultLog
    """Where labels are counted that fbench has no use for."""

    def truths(self) -> Iterator[Truth]:
        """Read the boxes in the order of stamps, or of frames where the file counts these (`frame_index`; with
        `frame_number` where a log's own numbers may be meant). `log_ns` is `stamp_ns` where the file doesn't say when a
        result was there. Boxes that aren't finite come as they are.

        Raises:
            ConfigError: where a camera or coordinate frame isn't known.
            LogError: naming file, row, column and what was expected; where one id is twice in a frame.
        """
        try:
            for truth in FORMATS[self.format](self.source, self.coordinates, self.faults):
                _require_unique(truth, self.source)
                yield truth
        except DataError as error:
            raise LogError(f"{self.source.path}: {error}") from error

    def labels(self) -> Mapping[str, int]:
        """Read all, and count the boxes of each class as the source names it."""
        counts: Counter[str] = Counter()
        for truth in self.truths():
            for boxes in (truth.boxes3d, truth.boxes2d):
                if boxes is not None and boxes.source_label is not None:
                    counts.update(boxes.source_label.tolist())
        return dict(sorted(counts.items()))


def open_boxes(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> BoxFile:
    """Open a file or folder of boxes; reading begins with `truths`.

    Raises:
        ConfigError: where there is no such file or format.
        LogError: where its form isn't known.
    """
    return BoxFile(source, form_of(source), coordinates, faults)


def form_of(source: BoxSource) -> str:
    """Return which of `FORMATS` a file or folder has.

    Raises:
        ConfigError: where there is no such file or format.
        LogError: where its form isn't known.
    """
    if not source.path.exists():
        raise ConfigError(f"{source.path}: no such file or folder")
    if not (source.path.is_file() or source.path.is_dir()):  # a FIFO would block, a device could go on for ever
        raise ConfigError(f"{source.path}: neither a regular file nor a folder")
    form = source.format or recognised(source.path)
    if form not in FORMATS:
        raise ConfigError(f"'{form}' is no form of boxes{did_you_mean(form, FORMATS)}")
    return form


def _require_unique(truth: Truth, source: BoxSource) -> None:
    for boxes in (truth.boxes3d, truth.boxes2d):
        twice = None if boxes is None else _repeated(boxes)
        if twice is not None:
            at = f"{truth.stamp_ns} ns" if truth.frame_index is None else f"frame {truth.frame_index}"
            raise LogError(f"{source.path}: id {twice} twice at {at}; an id names one object of a frame", "GT003")


def _repeated(boxes: Boxes2D | Boxes3D) -> int | None:
    """An id that two boxes have; in images each camera has its own."""
    if boxes.track_id is None:
        return None
    cameras = boxes.camera if isinstance(boxes, Boxes2D) else np.zeros(len(boxes), np.int64)
    named = boxes.track_id >= 0
    for camera in np.unique(cameras[named]):
        ids, times = np.unique(boxes.track_id[named & (cameras == camera)], return_counts=True)
        if (times > 1).any():
            return int(ids[times > 1][0])
    return None
