"""Frames of KITTI's tracking and object benchmarks: `label_02/0000.txt`, `calib/0000.txt`, `image_02/0000/000000.png`,
`velodyne/0000/000000.bin`, `oxts/0000.txt` ...; and `label_2/000000.txt`, `calib/000000.txt`, `image_2/000000.png` ...

A. Geiger, P. Lenz and R. Urtasun, "Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite", CVPR 2012.
"""

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

from fbench.datasets.importing.files import entries, find_numbered, is_number
from fbench.datasets.kitti import labels, sensors
from fbench.datasets.kitti.labels import CAMERA, OBJECT_DIGITS, TRACKING_DIGITS, Results, SequenceRows
from fbench.datasets.kitti.oxts import Fix, World, fix_of
from fbench.datasets.kitti.sensors import IMAGES, LIDAR, POINTS, SENSORS, Calibration
from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.importing import BadInput, ImportRequest, file_facts
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.data.metadata import GAPS, MEANT
from fbench.replay.data.rig import Rig
from fbench.replay.formats.objects import LabeledObject
from fbench.replay.formats.text import frame_number, lines

TRACKING_LABELS, OBJECT_LABELS = "label_02", "label_2"
_FRAME_DIGITS = 6
_CAMERAS = {sensors.camera_name(number): number for number in (2, 3)}
_FOLDERS = {**{f"image_{number}": (name, IMAGES) for name, number in _CAMERAS.items()}, "velodyne": (LIDAR, POINTS)}
"""Sensor and suffixes by the folder of its files."""


def sequences(folder: Path) -> list[str]:
    """Names of the sequences that have labels or files of sensors, sorted; empty where there are none."""
    named = {path.stem for path in find_numbered(folder / TRACKING_LABELS, (".txt",), TRACKING_DIGITS).values()}
    for sensor in SENSORS:
        inner = entries(folder / sensor)
        named.update(path.name for path in inner if is_number(path.name, TRACKING_DIGITS) and path.is_dir())
    return sorted(named)


class TrackingFrames:
    """One sequence."""

    benchmark = "tracking"
    period_ns = 100_000_000  # KITTI's cameras and LiDAR run at 10 Hz; the benchmark comes without stamps

    def __init__(self, name: str, folder: Path, sequence: str, request: ImportRequest, detections: Path | None) -> None:
        self.name, self.folder, self._sequence, self._request, self._detections = (
            name,
            folder,
            sequence,
            request,
            detections,
        )
        texts = (folder / kind / f"{sequence}.txt" for kind in (TRACKING_LABELS, "calib", "oxts"))
        self._label_path, self._calibration_path, self._poses_path = texts

    @cached_property
    def files(self) -> Mapping[str, Mapping[int, Path]]:
        """Files of the chosen frames by sensor; sensors without any are absent."""
        return {
            sensor: {number: path for number, path in paths.items() if number in self._request.frames}
            for sensor, paths in self._all_files.items()
        }

    @cached_property
    def _all_files(self) -> Mapping[str, Mapping[int, Path]]:
        found = {
            sensor: find_numbered(self.folder / sensor / self._sequence, suffixes, _FRAME_DIGITS)
            for sensor, suffixes in SENSORS.items()
        }
        return {sensor: paths for sensor, paths in found.items() if paths}

    @cached_property
    def numbers(self) -> Sequence[int]:
        """Up to the last frame of any file, without files by the list of sequences; at least to the last label."""
        num = self._num_frames
        if num == 0:
            raise LogError(f"{self.folder}: sequence {self._sequence} has no frame")
        if num > labels.MAX_FRAMES:
            limit = f"more than {labels.MAX_FRAMES}"
            raise LimitError(f"{self.folder}: sequence {self._sequence} has {num} frames, {limit}")
        return [number for number in range(num) if number in self._request.frames]

    @cached_property
    def _num_frames(self) -> int:
        labeled = 0 if self._rows is None else self._rows.num_frames
        return max(self._num_by_files or self._num_listed(), labeled)

    def _num_listed(self) -> int:
        """How many frames the benchmark's `evaluate_tracking.seqmap*` says: `0000 empty 000000 000154`."""
        is_test, name = self.folder.name == "testing", "evaluate_tracking.seqmap"
        for path in (*entries(self.folder), *entries(self.folder.parent)):
            if path.name.startswith(name) and is_test == (path.suffix == ".test") and path.is_file():
                for line in lines(path):
                    if line.fields[0] == self._sequence and len(line.fields) == 4:
                        return frame_number(line.fields[3], line.where)
        return 0

    @property
    def _num_by_files(self) -> int:
        return max((max(paths) + 1 for paths in self._all_files.values()), default=0)

    @cached_property
    def _rows(self) -> SequenceRows | None:
        path, request = self._label_path, self._request
        if not os.path.lexists(path):
            return None
        return labels.sequence_rows(path, labels.tracking_label, request.frames, request.bad)

    @cached_property
    def _fixes(self) -> Mapping[int, Fix]:
        """Where the IMU was in all frames, as the first one is the origin of the world; none without a file."""
        found = {}
        for line in sensors.read_bounded_lines(self._poses_path) if self._poses_path.is_file() else ():
            try:
                found[line.number - 1] = fix_of(" ".join(line.fields), line.where)
            except LogError as error:
                self._request.bad.report(error)
        return found

    @cached_property
    def _world(self) -> World | None:
        """`None` without poses, or where the calibration doesn't tell where the IMU is."""
        first = next(iter(self._fixes.values()), None)
        return None if first is None or self._calibration.body_T_imu is None else World(first)

    @cached_property
    def results(self) -> Results | None:
        """Another system's results; rows behind the last frame are those of another sequence."""
        if self._detections is None:
            return None
        found = labels.sequence_results(self._detections, self._sequence, self._request.frames, self._request.bad)
        if found is not None and found.num_frames > self._num_frames:
            there = f"sequence {self._sequence} has {self._num_frames} frames; are the results of another one?"
            self._request.bad.report(LogError(f"{found.files[0]}: has frame {found.num_frames - 1}, but {there}"))
        return found

    @cached_property
    def _calibration(self) -> Calibration:
        cameras = [_CAMERAS[sensor] for sensor in self._cameras]
        return sensors.read_calibration(self._calibration_path, cameras, LIDAR in self._all_files)

    @cached_property
    def _cameras(self) -> Sequence[str]:
        """Those with images, and the one that labels and results belong to."""
        has_boxes = self._rows is not None or self.results is not None
        return [sensor for sensor in _CAMERAS if sensor in self._all_files or (sensor == CAMERA and has_boxes)]

    @cached_property
    def rig(self) -> Rig:
        """Sensors at the first frame."""
        sizes_wh = {_CAMERAS[sensor]: self._sizes[sensor][0] for sensor in self._sizes}
        return sensors.rig_of(self._calibration, sizes_wh, LIDAR in self._all_files)

    @cached_property
    def _sizes(self) -> Mapping[str, tuple[tuple[int, int], str]]:
        """Size [px] of each camera's images, and how it is known."""
        rows = [] if self._rows is None else [row for objects in self._rows.frames.values() for row in objects]
        sizes = {}
        for sensor in self._cameras:
            size_wh = sensors.first_size(self._all_files.get(sensor, {}).values())
            P = self._calibration.projections[_CAMERAS[sensor]]
            sizes[sensor] = sensors.size_without_images(P, rows) if size_wh is None else (size_wh, "of the images")
        return sizes

    def image_size(self, sensor: str) -> tuple[int, int] | None:
        """Size [px] that all images of a camera must have: that of the first one."""
        return self._sizes[sensor][0]

    def rig_at(self, number: int, sizes_wh: Mapping[str, tuple[int, int]]) -> Rig:
        """Sensors at a frame: the same throughout."""
        return self.rig

    def labels(self, number: int) -> Sequence[LabeledObject] | None:
        """Labeled objects of a frame: every frame of a sequence with a file is labeled, else `None`."""
        return None if self._rows is None else self._rows.frames.get(number, ())

    def pose(self, number: int, stamp_ns: int) -> Pose | None:
        """The body's pose at a frame, where it is known."""
        if self._world is None or number not in self._fixes:
            return None
        return self._world.body_pose(self._fixes[number], self._calibration, stamp_ns, number)

    @property
    def facts(self) -> Sequence[str]:
        """What tells these files from others."""
        paths = [path for of_sensor in self.files.values() for path in of_sensor.values()]
        texts = (self._label_path, self._calibration_path, self._poses_path)
        return [self._sequence, str(self._num_frames), *file_facts(self.folder, [*texts, *paths])]

    @property
    def metadata(self) -> Mapping[str, str]:
        """The benchmark's own facts."""
        about = {
            "sequence": self._sequence,
            "stamps": "made up: frame N at N + 1 times 0.1 s; the benchmark has none, KITTI recorded at 10 Hz",
            "truth.truncation": "0 not, 1 partly, 2 largely truncated",
            **{f"{sensor}.size": how for sensor, (_, how) in self._sizes.items()},
            **({} if self._world is None else self._world.metadata),
        }
        return about | ({} if self.results is None else {"detections": self.results.files[0].name})

    @property
    def notes(self) -> Sequence[str]:
        """Lines for the summary."""
        notes = [f"{sensor}: {size[0]}x{size[1]} px, {how}" for sensor, (size, how) in self._sizes.items()]
        labeled = 0 if self._rows is None else self._rows.num_frames
        if 0 < self._num_by_files < labeled:
            notes.append(f"labels go on behind the last file: frames {self._num_by_files} to {labeled - 1}")
        if self._detections is not None and self.results is None:
            notes.append(f"detections: none, {self._detections.name} has no {self._sequence}.txt")
        if not self._fixes:
            notes.append("poses: none")
        elif self._world is None:
            notes.append("poses: left out, as the calibration doesn't tell where the IMU is")
        else:
            last, num = max(self._fixes) + 1, self._num_frames
            odd = "" if last == num else f", though the sequence has {num} frames"
            notes.append(f"poses: of frames 0 to {last - 1}{odd}")
        return [*notes, "stamps: made up at 10 Hz, the benchmark has none"]


def has_frames(folder: Path) -> bool:
    """Tell whether a folder holds frames of the benchmark."""
    folders = {OBJECT_LABELS: (".txt",), **{inner: suffixes for inner, (_, suffixes) in _FOLDERS.items()}}
    return any(find_numbered(folder / inner, suffixes, OBJECT_DIGITS) for inner, suffixes in folders.items())


class ObjectFrames:
    """All frames of a folder. They aren't a sequence: each has its own calibration."""

    benchmark = "object"
    period_ns = 10_000_000_000  # So far apart that each frame is a segment of its own

    def __init__(self, name: str, folder: Path, request: ImportRequest, detections: Path | None) -> None:
        self.name, self.folder, self._request, self._detections = name, folder, request, detections

    @cached_property
    def files(self) -> Mapping[str, Mapping[int, Path]]:
        """Files of the chosen frames by sensor; sensors without any are absent."""
        found = {
            sensor: find_numbered(self.folder / inner, suffixes, OBJECT_DIGITS, self._request.frames)
            for inner, (sensor, suffixes) in _FOLDERS.items()
        }
        return {sensor: paths for sensor, paths in found.items() if paths}

    @cached_property
    def _label_files(self) -> Mapping[int, Path]:
        return find_numbered(self.folder / OBJECT_LABELS, (".txt",), OBJECT_DIGITS, self._request.frames)

    @cached_property
    def numbers(self) -> Sequence[int]:
        """Those of all files, calibration and results apart."""
        found = sorted(set(self._label_files).union(*self.files.values()))
        if not found:
            raise LogError(f"{self.folder}: no frame from {self._request.frames}")
        return found

    @cached_property
    def results(self) -> Results | None:
        """Another system's results."""
        if self._detections is None:
            return None
        files = find_numbered(self._detections, (".txt",), OBJECT_DIGITS, self._request.frames)
        found = labels.frame_results(files, self._request.bad)
        for number in sorted(set(files).difference(self.numbers)):
            where = f"{self._detections / f'{number:06d}.txt'}: no such frame in {self.folder}"
            self._request.bad.report(LogError(f"{where}; are the results of another set?"))
        return found

    @cached_property
    def rig(self) -> Rig:
        """That of the first frame whose calibration can be used."""
        for number in self.numbers[:-1]:
            try:
                return self._rig_by_headers(number)
            except LogError:
                if not self._request.bad.skip:  # else it is met, and counted, with the frame
                    raise
        return self._rig_by_headers(self.numbers[-1])

    def _rig_by_headers(self, number: int) -> Rig:
        images = {name: paths[number] for name, paths in self.files.items() if name != LIDAR and number in paths}
        sizes_wh = {sensor: sensors.first_size([path]) for sensor, path in images.items()}
        return self.rig_at(number, {sensor: size for sensor, size in sizes_wh.items() if size is not None})

    def image_size(self, sensor: str) -> tuple[int, int] | None:
        """Size [px] that all images of a camera must have; `None`, as each frame has its own."""
        return None

    def rig_at(self, number: int, sizes_wh: Mapping[str, tuple[int, int]]) -> Rig:
        """Sensors at a frame whose images have these sizes [px]: all of the set, also those that it has no file of."""
        path, has_lidar = self._calibration_path(number), LIDAR in self.files
        calibration = sensors.read_calibration(path, self._cameras, has_lidar)
        sizes = {
            camera: sizes_wh.get(sensors.camera_name(camera)) or self._size_without_image(number, P)
            for camera, P in calibration.projections.items()
            if camera in self._cameras
        }
        return sensors.rig_of(calibration, sizes, has_lidar)

    @cached_property
    def _cameras(self) -> frozenset[int]:
        """Those with images, and the one that labels and results belong to."""
        names = set(self.files) - {LIDAR} | ({CAMERA} if self._label_files or self.results is not None else set())
        return frozenset(_CAMERAS[name] for name in names)

    def _size_without_image(self, number: int, P: Float64) -> tuple[int, int]:
        path = self._label_files.get(number)
        quiet = BadInput(skip=True)  # what is wrong with a row is told when the labels are read
        rows = [] if path is None else labels.frame_rows(path, labels.object_label, quiet)
        return sensors.size_without_images(P, rows)[0]

    def _calibration_path(self, number: int) -> Path:
        return self.folder / "calib" / f"{number:06d}.txt"

    def labels(self, number: int) -> Sequence[LabeledObject] | None:
        """Labeled objects of a frame; `None` without a file, which may be empty."""
        path = self._label_files.get(number)
        return None if path is None else labels.frame_rows(path, labels.object_label, self._request.bad)

    def pose(self, number: int, stamp_ns: int) -> Pose | None:
        """The body's pose at a frame: never known."""
        return None

    @property
    def facts(self) -> Sequence[str]:
        """What tells these files from others."""
        paths = [path for of_sensor in self.files.values() for path in of_sensor.values()]
        calibrations = map(self._calibration_path, self.numbers)
        return file_facts(self.folder, [*calibrations, *self._label_files.values(), *paths])

    @property
    def metadata(self) -> Mapping[str, str]:
        """The benchmark's own facts."""
        about = {
            GAPS: MEANT,
            "stamps": "made up: frame N at N + 1 times 10 s; the frames are no sequence, each is a segment of its own",
            "truth.truncation": "share of the object outside of the image, 0 to 1",
        }
        return about | ({} if self.results is None else {"detections": f"{len(self.results.files)} files"})

    @property
    def notes(self) -> Sequence[str]:
        """Lines for the summary."""
        notes = ["stamps: made up, 10 s apart: the frames are no sequence, each is a segment of its own"]
        if CAMERA not in self.files and _CAMERAS[CAMERA] in self._cameras:
            notes.append(f"{CAMERA}: without images, sizes are those of the days of recording by their focal lengths")
        if self._detections is not None and self.results is None:
            notes.append(f"detections: none, {self._detections.name} has no files like 000000.txt of these frames")
        return notes
