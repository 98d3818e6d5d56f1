"""Raw drives of KITTI, https://www.cvlibs.net/datasets/kitti/raw_data.php.

`DATE/calib_*.txt`; in `DATE/DATE_drive_NNNN_sync/`: `tracklet_labels.xml`, and `image_00` to `image_03`,
`velodyne_points` and `oxts`, each with `data/` and `timestamps.txt`. `_sync` drives are rectified, and files of one
number are one frame; those of `_extract` drives are as they were recorded, each sensor with its own numbers.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from io import StringIO
from itertools import pairwise
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import find_runs, format_counts, format_runs, read_floats, read_image
from fbench.datasets.kitti import oxts
from fbench.datasets.kitti.oxts import SENSOR as OXTS
from fbench.datasets.kitti.raw import calibration
from fbench.datasets.kitti.raw.calibration import IMU_TO_LIDAR, LIDAR_TO_CAMERA, DriveCalibration
from fbench.datasets.kitti.raw.files import CAMERAS, Drive, Entry, find_drives, open_drive, order_files
from fbench.datasets.kitti.raw.tracklets import FILE as TRACKLETS
from fbench.datasets.kitti.raw.tracklets import Tracklets, read_tracklets
from fbench.datasets.kitti.sensors import LIDAR, KittiParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.importing import ImportRequest, describe_params, file_facts, log_id, read_text
from fbench.replay.contracts.protocols import Recording
from fbench.replay.data.arrays import Float32
from fbench.replay.data.messages import Message, PointCloud, Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.formats.text import digest_of
from fbench.replay.logs.coordinate_frames import BODY

_LISTED = 20
_STAMPS = (
    "each sensor's own, as recorded; local time without a zone, taken as UTC; the LiDAR's is when it faced forward, "
    "its points have no times of their own"
)


def _gaps(numbers: Sequence[int]) -> list[range]:
    """Return the runs of numbers that lack, between numbers that ascend."""
    return [range(a + 1, b) for a, b in pairwise(numbers) if b > a + 1]


def _format_ranges(found: Iterable[range]) -> str:
    return format_runs(found, _LISTED)


def recording(name: str, source: Path, request: ImportRequest, params: KittiParams) -> Recording:
    """Open a drive of `find_drives`. Raises ConfigError for results of another system, which only benchmarks have."""
    if params.detections is not None:
        raise ConfigError(f"{params.detections}: raw drives can't take detections, whose files are those of benchmarks")
    return RawRecording(name, find_drives(source)[name], request, params)


class RawRecording:
    """One drive; see `Recording`."""

    def __init__(self, name: str, folder: Path, request: ImportRequest, params: KittiParams) -> None:
        self.name, self._folder, self._request, self._params = name, folder, request, params
        # What was imported: the numbers of the files of each sensor, in the order of their stamps
        self._numbers: dict[str, list[int]] = {}
        self._stamps_ns: list[int] = []  # The first and the last one
        self._tracklets: Tracklets | None = None
        self._labels: Counter[str] = Counter()  # Of boxes, as the source names them
        self._states: Counter[str] = Counter()
        self._odd: list[str] = []

    @cached_property
    def _drive(self) -> Drive:
        return open_drive(self.name, self._folder)

    @cached_property
    def _calibration(self) -> DriveCalibration:
        return calibration.read_calibration(self._drive)

    @property
    def rig(self) -> Rig:
        """The sensors that have files; body coordinates are those of the rectified camera 0, with axes turned."""
        return self._calibration.rig

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the drive."""
        drive = self._drive
        date, _, kind = self.name.partition("_drive_")
        metadata = {
            CAMERA0: BODY,
            "dataset": "KITTI raw",
            "licence": "CC BY-NC-SA 3.0",
            "date": date,
            "drive": kind.partition("_")[0],
            "images": "rectified" if drive.is_rectified else "as recorded, distorted",
            "frames": str(len(drive.series[drive.reference].paths)),
            "stamps": _STAMPS,
            "reference": drive.reference,
            **({"calibrated": self._calibration.made} if self._calibration.made else {}),
            **({} if self._world is None else self._world.metadata),
            **describe_params(self._params),
        }
        return LogInfo(self.name, log_id("kitti", self._facts(), self._request.frames, self._params), metadata)

    def _facts(self) -> Iterator[str]:
        """What tells drives apart: also what stands in small files, where another number takes as many bytes."""
        drive, root = self._drive, self._drive.calibration_folder
        files = [path for series in drive.series.values() for path in series.paths.values()]
        yield from file_facts(root, files)
        small = [series.stamps_path for series in drive.series.values()]
        for path in (*(root / name for name in calibration.FILES), *small, drive.folder / TRACKLETS):
            yield f"{path.relative_to(root).as_posix()} {digest_of(path) if path.is_file() else 'missing'}"

    @cached_property
    def _world(self) -> oxts.World | None:
        """Its origin is the drive's first pose, whichever frames are imported; `None` where there are no poses."""
        if OXTS not in self._drive.series or self._calibration.calibration.body_T_imu is None:
            return None
        for path in self._drive.series[OXTS].paths.values():
            try:
                return oxts.World(oxts.read_fix(path))
            except LogError:
                if not self._request.bad.skip:
                    raise
        return None

    @property
    def num_items(self) -> int:
        """About a message a file."""
        return sum(len(series.paths) for series in self._drive.series.values())

    def items(self) -> Iterator[Message | Truth]:
        """All measurements by their stamps, and the boxes at those of the reference sensor."""
        self._tracklets = self._read_tracklets()
        sensors = set(self._drive.series) - ({OXTS} if self._world is None else set())
        for entry in order_files(self._drive, sensors, self._request.frames, self._request.bad.report):
            try:
                message = self._message(entry)
            except LogError as error:
                self._request.bad.report(error)
                continue
            yield message
            self._numbers.setdefault(entry.sensor, []).append(entry.number)
            self._stamps_ns = [*self._stamps_ns[:1], entry.stamp_ns]
            if self._tracklets is not None and entry.sensor == self._drive.reference:
                boxes = self._tracklets.of(entry.number)
                for texts, counter in ((boxes.source_label, self._labels), (boxes.attribute, self._states)):
                    counter.update([] if texts is None else texts.tolist())
                yield Truth(entry.stamp_ns, entry.stamp_ns, boxes, frame_number=entry.number)

    def _message(self, entry: Entry) -> Message:
        stamp_ns, sensor, number = entry
        path = self._drive.series[sensor].paths[number]
        frame_number = number if self._drive.is_rectified else None
        if sensor == OXTS:
            fix, known = oxts.read_fix(path), self._calibration.calibration
            pose = None if self._world is None else self._world.body_pose(fix, known, stamp_ns, frame_number)
            if pose is None:
                raise LogError(f"{path}: no calibration of the IMU")
            return pose
        if sensor == LIDAR:
            points = read_floats(path, 4) if path.suffix == ".bin" else _read_rows(path)
            return PointCloud(sensor, stamp_ns, stamp_ns, points[:, :3], points[:, 3], frame_number=frame_number)
        return read_image(path, sensor, stamp_ns, self.rig.cameras[sensor].size_wh, frame_number=frame_number)

    def _read_tracklets(self) -> Tracklets | None:
        path = self._drive.folder / TRACKLETS
        if not os.path.lexists(path):
            return None
        if not self._drive.is_rectified:
            self._odd.append(f"{TRACKLETS}: left out, it counts the frames of the synchronized drive")
            return None
        body_T_velo = self._calibration.body_T_velo
        if body_T_velo is None:
            raise LogError(f"{path}: needs calib_velo_to_cam.txt, which is missing")
        try:
            return read_tracklets(path, body_T_velo, self._request.bad.report)
        except LogError as error:
            self._request.bad.report(error)
            return None

    def summary(self) -> Sequence[str]:
        """What was found."""
        drive, lines = self._drive, []
        duration_s = (self._stamps_ns[-1] - self._stamps_ns[0]) / 1e9 if self._stamps_ns else 0.0
        counts = ", ".join(f"{name} {len(numbers)}" for name, numbers in sorted(self._numbers.items()))
        lines.append(f"measurements: {counts or 'none'} in {duration_s:.1f} s, {drive.reference} gives the frames")
        for name, numbers in sorted(self._numbers.items()):
            if turns := [b for a, b in pairwise(numbers) if b < a]:
                files = _format_ranges(find_runs(sorted(turns)))
                lines.append(f"{name}: stamps run backwards, files {files} are earlier than others")
        lines += self._missing_lines()
        if OXTS in drive.series and OXTS not in self._numbers:
            texts = (name for name in (LIDAR_TO_CAMERA, IMU_TO_LIDAR) if not (drive.calibration_folder / name).exists())
            needed = " and ".join(texts)
            lines.append(f"no poses: {f'{needed} missing' if needed else 'no file of oxts could be used'}")
        return [*lines, *self._box_lines(), *self._odd, "stamps: local time without a zone, taken as UTC"]

    def _missing_lines(self) -> Iterator[str]:
        drive, frames = self._drive, self._request.frames
        absent = [name for name in (*CAMERAS, LIDAR, OXTS) if name not in drive.series]
        if absent:
            yield f"no files of {', '.join(absent)}"
        known = set().union(*(series.paths for series in drive.series.values())) if drive.is_rectified else set()
        for name, series in sorted(drive.series.items()):
            if missing := find_runs(sorted(n for n in known - set(series.paths) if n in frames)):
                yield f"{name}: no file of frames {_format_ranges(missing)}"
            if gaps := [] if drive.is_rectified else _gaps(list(series.paths)):
                yield f"{name}: no file of number {_format_ranges(gaps)}"
            if series.others:
                yield f"{name}: {len(series.others)} other files left out, such as {series.others[0]}"
        if gaps := _gaps(sorted(n for n in known if n in frames)):
            yield f"no file at all of frames {_format_ranges(gaps)}"

    def _box_lines(self) -> Iterator[str]:
        drive, tracklets = self._drive, self._tracklets
        if tracklets is None:
            yield f"no boxes: no {TRACKLETS}" if not (drive.folder / TRACKLETS).exists() else "no boxes"
            return
        kinds = format_counts(self._labels)
        boxes = f"boxes: {self._labels.total()}{f' ({kinds})' if kinds else ''} of {tracklets.num_tracks} tracklets"
        yield f"{boxes}, {self._states['interpolated']} of them interpolated between labeled ones"
        there, wanted = drive.series[drive.reference].paths, self._request.frames
        lost = [frame for frame in tracklets.frame.tolist() if frame in wanted and frame not in there]
        if lost:
            frames = _format_ranges(find_runs(sorted(set(lost))))
            yield f"boxes left out: {len(lost)} in frames {frames}, which {drive.reference} hasn't"


def _read_rows(path: Path) -> Float32:
    """Rows (N, 4) of a text: x, y, z [m], reflectance."""
    text = read_text(path)
    if not text.strip():
        return np.zeros((0, 4), np.float32)
    try:
        rows = np.loadtxt(StringIO(text), np.float32, comments=None, ndmin=2)
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    if rows.shape[1] != 4:
        raise LogError(f"{path}: rows of {rows.shape[1]} numbers, expected 4")
    return rows
