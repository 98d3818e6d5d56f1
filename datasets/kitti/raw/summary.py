"""What the import of a raw drive of KITTI found, and what was odd."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from fbench.datasets.kitti.oxts import SENSOR as OXTS
from fbench.datasets.kitti.raw.calibration import IMU_TO_LIDAR, LIDAR_TO_CAMERA
from fbench.datasets.kitti.raw.files import CAMERAS, Drive
from fbench.datasets.kitti.raw.tracklets import FILE as TRACKLETS
from fbench.datasets.kitti.raw.tracklets import Tracklets
from fbench.datasets.kitti.rig import LIDAR
from fbench.replay.boxes import Boxes3D
from fbench.replay.imports.wish import FrameRange
from fbench.replay.imports.words import counted, listed_runs, runs

_LISTED = 20


@dataclass
class Findings:
    """What the import met."""

    frames: FrameRange
    """Which ones were asked for."""
    numbers: dict[str, list[int]] = field(default_factory=dict)
    """Of the files of each sensor that were imported, in the order of their stamps."""
    first_ns: int | None = None
    last_ns: int = 0
    tracklets: Tracklets | None = None
    boxes: Counter[str] = field(default_factory=Counter)
    """By their source label."""
    states: Counter[str] = field(default_factory=Counter)
    odd: list[str] = field(default_factory=list)

    def add(self, sensor: str, number: int, stamp_ns: int) -> None:
        """Count one measurement."""
        self.numbers.setdefault(sensor, []).append(number)
        self.first_ns = stamp_ns if self.first_ns is None else self.first_ns
        self.last_ns = stamp_ns

    def add_boxes(self, boxes: Boxes3D) -> None:
        """Count the boxes of one frame."""
        for texts, counter in ((boxes.source_label, self.boxes), (boxes.attribute, self.states)):
            counter.update([] if texts is None else texts.tolist())


def summary_lines(drive: Drive, findings: Findings) -> Sequence[str]:
    """Return the lines of the summary."""
    return [
        *_found_lines(drive, findings),
        *_missing_lines(drive, findings),
        *_pose_lines(drive, findings),
        *_box_lines(drive, findings),
        *findings.odd,
        "stamps: local time without a zone, taken as UTC",
    ]


def _found_lines(drive: Drive, findings: Findings) -> Iterator[str]:
    duration_s = (findings.last_ns - (findings.first_ns or 0)) / 1e9
    counts = ", ".join(f"{name} {len(numbers)}" for name, numbers in sorted(findings.numbers.items()))
    yield f"measurements: {counts or 'none'} in {duration_s:.1f} s, {drive.reference} gives the frames"
    for name, numbers in sorted(findings.numbers.items()):
        if turns := [b for a, b in pairwise(numbers) if b < a]:
            yield f"{name}: stamps run backwards, files {_listed(runs(sorted(turns)))} are earlier than others"


def _missing_lines(drive: Drive, findings: Findings) -> Iterator[str]:
    absent = [name for name in (*CAMERAS, LIDAR, OXTS) if name not in drive.series]
    if absent:
        yield f"no files of {', '.join(absent)}"
    known = set().union(*(series.paths for series in drive.series.values())) if drive.is_rectified else set()
    for name, series in sorted(drive.series.items()):
        missing = runs(sorted(n for n in known - set(series.paths) if n in findings.frames))
        if missing:
            yield f"{name}: no file of frames {_listed(missing)}"
        gaps = [] if drive.is_rectified else _gaps(list(series.paths))
        if gaps:
            yield f"{name}: no file of number {_listed(gaps)}"
        if series.others:
            yield f"{name}: {len(series.others)} other files left out, such as {series.others[0]}"
    if gaps := _gaps(sorted(n for n in known if n in findings.frames)):
        yield f"no file at all of frames {_listed(gaps)}"


def _pose_lines(drive: Drive, findings: Findings) -> Iterator[str]:
    if OXTS not in drive.series or OXTS in findings.numbers:
        return
    needed = [name for name in (LIDAR_TO_CAMERA, IMU_TO_LIDAR) if not (drive.calibration_folder / name).exists()]
    why = f"{' and '.join(needed)} missing" if needed else "no file of oxts could be used"
    yield f"no poses: {why}"


def _box_lines(drive: Drive, findings: Findings) -> Iterator[str]:
    tracklets = findings.tracklets
    if tracklets is None:
        yield f"no boxes: no {TRACKLETS}" if not (drive.folder / TRACKLETS).exists() else "no boxes"
        return
    kinds = counted(findings.boxes)
    interpolated = findings.states["interpolated"]
    yield (
        f"boxes: {findings.boxes.total()}{f' ({kinds})' if kinds else ''} of {tracklets.num_tracks} tracklets, "
        f"{interpolated} of them interpolated between labelled ones"
    )
    there = drive.series[drive.reference].paths
    sensor = drive.reference
    lost = [frame for frame in tracklets.frame.tolist() if frame in findings.frames and frame not in there]
    if lost:
        yield f"boxes left out: {len(lost)} in frames {_listed(runs(sorted(set(lost))))}, which {sensor} hasn't"


def _gaps(numbers: Sequence[int]) -> list[range]:
    """Return the runs of numbers that lack, between numbers that ascend."""
    return [range(a + 1, b) for a, b in pairwise(numbers) if b > a + 1]


def _listed(found: Iterable[range]) -> str:
    return listed_runs(found, _LISTED)
