"""Opening of a file or folder of boxes, whatever its format."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import ConfigError, DataError, LogError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.formats.kitti import open_ab3dmot, open_kitti, open_kitti_tracking
from fbench.replay.formats.mot import find_sequence_info, open_mot
from fbench.replay.formats.nuscenes import find_companion, open_nuscenes
from fbench.replay.formats.openlabel import open_openlabel
from fbench.replay.formats.recognition import recognize
from fbench.replay.formats.table import open_table
from fbench.replay.formats.text import digest_of
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource
from fbench.replay.runs.digest import digest
from fbench.replay.runs.manifest import InputEntry, TruthEntry

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
    format: str  # One of `FORMATS`
    coordinates: CoordinateFrames
    faults: FaultLog  # Where labels are counted that fbench has no use for

    def truths(self) -> Iterator[Truth]:
        """Read the boxes in the order of stamps, or of frames where the file counts these (`frame_index`; with
        `frame_number` where a log's own numbers may be meant). `log_ns` is `stamp_ns` where the file doesn't say when a
        result was there. Boxes that aren't finite come as they are. Raises ConfigError where a camera or coordinate
        frame isn't known. Raises LogError naming file, row, column and what was expected; where one id is twice in a
        frame.
        """
        try:
            for truth in FORMATS[self.format](self.source, self.coordinates, self.faults):
                for boxes in (truth.boxes3d, truth.boxes2d):
                    if boxes is not None and (twice := _find_repeated_id(boxes)) is not None:
                        at = f"{truth.stamp_ns} ns" if truth.frame_index is None else f"frame {truth.frame_index}"
                        where = f"{self.source.path}: id {twice} twice at {at}"
                        raise LogError(f"{where}; an id names one object of a frame", "GT003")
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
    """Open a file or folder of boxes; reading begins with `truths`. Raises as `form_of`."""
    return BoxFile(source, form_of(source), coordinates, faults)


def form_of(source: BoxSource) -> str:
    """Return which of `FORMATS` a file has. ConfigError: no such file or format; LogError: its form isn't known."""
    if not source.path.exists():
        raise ConfigError(f"{source.path}: no such file or folder")
    if not (source.path.is_file() or source.path.is_dir()):  # a FIFO would block, a device could go on for ever
        raise ConfigError(f"{source.path}: neither a regular file nor a folder")
    form = source.format or recognize(source.path)
    if form not in FORMATS:
        raise ConfigError(f"'{form}' is no form of boxes{did_you_mean(form, FORMATS)}")
    return form


def _find_repeated_id(boxes: Boxes2D | Boxes3D) -> int | None:
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


def truth_entry(source: BoxSource, classes: Mapping[str, str] | None = None) -> TruthEntry:
    """Say where truth comes from, for the manifest, and which labels names of classes got apart from the replay. Raises
    as `form_of`; LogError also where it can't be read.
    """
    form, digest_ = digest_boxes(source)
    named = digest(dict(sorted(classes.items()))) if classes else ""
    return TruthEntry(
        name=source.path.name, format=form, digest=digest_, frame=source.frame, camera=source.camera, classes=named
    )


def results_entry(source: BoxSource) -> InputEntry:
    """Say where results of another system come from, for the manifest. Raises as `truth_entry`."""
    _, digest_ = digest_boxes(source)
    return InputEntry(role="results", name=source.path.name, digest=digest_, frame=source.frame, camera=source.camera)


def digest_boxes(source: BoxSource) -> tuple[str, str]:
    """Return the form of a file or folder, and its digest, with that of the file beside it that it is read with."""
    form, own = form_of(source), digest_of(source.path)
    find = {"nuscenes": find_companion, "mot": find_sequence_info}.get(form)
    companion = find(source.path) if find is not None and source.path.is_file() else None  # a folder holds its own
    return form, own if companion is None else digest((own, digest_of(companion)))
