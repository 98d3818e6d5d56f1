"""In which order the files of a raw drive of KITTI are read: that of their stamps."""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

from fbench.datasets.kitti.raw.files import Drive, Series, read_stamps
from fbench.replay.errors import LogError
from fbench.replay.imports.wish import FrameRange

Met = Callable[[LogError], None]
_END_NS = 2**63
"""Behind all stamps, which aren't negative."""


class Entry(NamedTuple):
    """One file."""

    stamp_ns: int
    sensor: str
    number: int


def ordered(drive: Drive, sensors: Collection[str], frames: FrameRange, met: Met) -> list[Entry]:
    """Return the files of some sensors that belong to a range of frames, by stamp.

    Numbers of files are those of frames in rectified drives. In others each sensor counts for itself: the range is one
    of the reference sensor's files, and takes what was recorded from its first stamp on until the first one after it.

    Args:
        drive: Where the files are.
        sensors: Which ones to read.
        frames: Which numbers.
        met: Is told of files without a stamp, and of sensors without stamps.

    Raises:
        LogError: where `met` raises, or the range is empty.
    """
    series = [series for name, series in sorted(drive.series.items()) if name in sensors]
    if drive.is_rectified:
        chosen = [entry for one in series for entry in _entries(one, frames, met)]
    else:
        everything = [entry for one in series for entry in _entries(one, FrameRange(), met)]
        window_ns = _window([entry for entry in everything if entry.sensor == drive.reference], frames)
        chosen = [entry for entry in everything if entry.stamp_ns in window_ns]
    if not chosen:
        numbers = list(drive.series[drive.reference].paths)
        raise LogError(f"{drive.folder}: no measurement in frames {frames}; there are {numbers[0]} to {numbers[-1]}")
    return sorted(chosen)


def _entries(series: Series, frames: FrameRange, met: Met) -> Iterator[Entry]:
    wanted = [number for number in series.paths if number in frames]
    try:
        stamps = read_stamps(series.stamps_path)
    except LogError as error:
        met(error)
        return
    for number in wanted:
        try:
            yield Entry(stamps.stamp_ns(number), series.sensor, number)
        except LogError as error:
            met(error)


def _window(reference: Sequence[Entry], frames: FrameRange) -> range:
    """Return the stamps [ns] that belong to a range of the reference sensor's files."""
    inside = [entry.stamp_ns for entry in reference if entry.number in frames]
    behind = [entry.stamp_ns for entry in reference if frames.stop is not None and entry.number >= frames.stop]
    if not inside:
        return range(0)
    return range(min(inside) if frames.first else 0, min(behind, default=_END_NS))
