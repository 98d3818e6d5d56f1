"""KITTI's object benchmark: `label_2/000000.txt`, `calib/000000.txt`, `image_2/000000.png`, ...

A. Geiger, P. Lenz and R. Urtasun, "Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite", CVPR 2012.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

from fbench.datasets.importing.files import find_numbered
from fbench.datasets.kitti import labels, sensors
from fbench.datasets.kitti.labels import CAMERA, OBJECT_DIGITS, Results
from fbench.datasets.kitti.sensors import IMAGES, LIDAR, POINTS
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput, ImportWish, file_facts
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.data.metadata import GAPS, MEANT
from fbench.replay.data.rig import Rig
from fbench.replay.formats.objects import LabeledObject

LABELS = "label_2"
PERIOD_NS = 10_000_000_000
_CAMERAS = {sensors.camera_name(number): number for number in (2, 3)}
_FOLDERS = {**{f"image_{number}": (name, IMAGES) for name, number in _CAMERAS.items()}, "velodyne": (LIDAR, POINTS)}
"""Sensor and suffixes by the folder of its files."""


def has_frames(folder: Path) -> bool:
    """Tell whether a folder holds frames of the benchmark."""
    folders = {LABELS: (".txt",), **{inner: suffixes for inner, (_, suffixes) in _FOLDERS.items()}}
    return any(find_numbered(folder / inner, suffixes, OBJECT_DIGITS) for inner, suffixes in folders.items())


class ObjectFrames:
    """All frames of a folder. They aren't a sequence: each has its own calibration."""

    benchmark = "object"
    period_ns = PERIOD_NS  # So far apart that each frame is a segment of its own

    def __init__(self, name: str, folder: Path, wish: ImportWish, detections: Path | None) -> None:
        self.name, self.folder, self._wish, self._detections = name, folder, wish, detections

    @cached_property
    def files(self) -> Mapping[str, Mapping[int, Path]]:
        """Files of the chosen frames by sensor; sensors without any are absent."""
        found = {
            sensor: find_numbered(self.folder / inner, suffixes, OBJECT_DIGITS, self._wish.frames)
            for inner, (sensor, suffixes) in _FOLDERS.items()
        }
        return {sensor: paths for sensor, paths in found.items() if paths}

    @cached_property
    def _label_files(self) -> Mapping[int, Path]:
        return find_numbered(self.folder / LABELS, (".txt",), OBJECT_DIGITS, self._wish.frames)

    @cached_property
    def numbers(self) -> Sequence[int]:
        """Those of all files, calibration and results apart."""
        found = sorted(set(self._label_files).union(*self.files.values()))
        if not found:
            raise LogError(f"{self.folder}: no frame from {self._wish.frames}")
        return found

    @cached_property
    def results(self) -> Results | None:
        """Another system's results."""
        if self._detections is None:
            return None
        files = find_numbered(self._detections, (".txt",), OBJECT_DIGITS, self._wish.frames)
        found = labels.frame_results(files, self._wish.bad)
        for number in sorted(set(files).difference(self.numbers)):
            where = f"{self._detections / f'{number:06d}.txt'}: no such frame in {self.folder}"
            self._wish.bad.report(LogError(f"{where}; are the results of another set?"))
        return found

    @cached_property
    def rig(self) -> Rig:
        """That of the first frame whose calibration can be used."""
        for number in self.numbers[:-1]:
            try:
                return self._rig_by_headers(number)
            except LogError:
                if not self._wish.bad.skip:  # else it is met, and counted, with the frame
                    raise
        return self._rig_by_headers(self.numbers[-1])

    def _rig_by_headers(self, number: int) -> Rig:
        images = {name: paths[number] for name, paths in self.files.items() if name != LIDAR and number in paths}
        sizes_wh = {sensor: sensors.first_size([path]) for sensor, path in images.items()}
        return self.rig_at(number, {sensor: size for sensor, size in sizes_wh.items() if size is not None})

    def expected_size(self, sensor: str) -> tuple[int, int] | None:
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
        return sensors.size_without_images(
            P, [] if path is None else labels.frame_rows(path, labels.object_label, quiet)
        )[0]

    def _calibration_path(self, number: int) -> Path:
        return self.folder / "calib" / f"{number:06d}.txt"

    def labels(self, number: int) -> Sequence[LabeledObject] | None:
        """Labeled objects of a frame; `None` without a file, which may be empty."""
        path = self._label_files.get(number)
        return None if path is None else labels.frame_rows(path, labels.object_label, self._wish.bad)

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
