"""Importer of the Astyx HiRes2019 set: one camera, a VLP-16 LiDAR, a 3D radar and 3D boxes.

M. Meyer and G. Kuschk, "Automotive Radar Dataset for Deep Learning Based 3D Object Detection", EuRAD 2019.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
from pyarrow import csv
from pydantic import BaseModel, Field, FiniteFloat

from fbench.datasets.astyx.calibration import CAMERA, KINDS, LIDAR, RADAR, read_rigs
from fbench.datasets.importing import files as importing
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, file_facts, log_id, read_bytes, require_folder
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.geometry.transforms import yaw_pitch_roll

CALIBRATION, TRUTH = "calibration", "groundtruth_obj3d"
VELOCITY_PERIOD_MPS = 10.3936
"""The radar's velocities come in 128 bins of 0.0812 m/s; faster ones alias with this period."""
GAP_NS = 2_000_000_000
HOUR_US = 3_600_000_000
LABELS = {
    "Car": "car", "Truck": "truck", "Bus": "bus", "Trailer": "trailer", "Towed Object": "trailer",
    "Person": "pedestrian", "Cyclist": "bicycle", "Motorcyclist": "motorcycle", "Other Vehicle": "other",
}  # fmt: skip
"""Classes of the set's specification; any other becomes `other` too."""
_SUFFIXES = {CAMERA: ".jpg", LIDAR: ".txt", RADAR: ".txt", CALIBRATION: ".json", TRUTH: ".json"}
_BLOCK = 128 * 1024  # Files are parsed in blocks of so many bytes, as many at a time as there are cores
_LISTED = 20
_Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Four = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_Length = Annotated[FiniteFloat, Field(gt=0)]


class Object(BaseModel):
    """One labeled object; `orientation_quat` is w, x, y, z."""

    classname: str
    center3d: _Three
    dimension3d: tuple[_Length, _Length, _Length]
    orientation_quat: _Four
    occlusion: FiniteFloat


class Objects(BaseModel):
    """One file of `groundtruth_obj3d/`."""

    objects: list[Object]


class Astyx:
    """Reads `camera_front/ lidar_vlp16/ radar_6455/ calibration/ groundtruth_obj3d/`, files named by frame number.

    The folder is one sequence.
    """

    def names(self, source: Path) -> Sequence[str]:
        """Name of the folder; see `Importer`."""
        require_folder(source)
        return [source.resolve().name]

    def recordings(self, source: Path, request: ImportRequest) -> Iterator["AstyxRecording"]:
        """Open the folder; see `Importer`."""
        for name in request.names:
            yield AstyxRecording(name, source, request)


class AstyxRecording:
    """One folder; see `Recording`.

    Time exists in the LiDAR's files only: the first point's time is the stamp of all messages of the frame. It
    counts within the hour; where it runs backwards from one frame to the next, whole hours are added.
    """

    def __init__(self, name: str, source: Path, request: ImportRequest) -> None:
        self.name, self._source, self._request = name, source, request
        self._frames: list[tuple[int, int]] = []  # Number and stamp [ns] of each
        self._timeless: list[int] = []
        self._turns: list[int] = []  # Frames before which the clock ran backwards
        self._changes: list[int] = []  # Frames with another calibration than the one before
        self._classes: Counter[str] = Counter()
        self._num_unlabeled = 0

    @cached_property
    def _files(self) -> Mapping[str, Mapping[int, Path]]:
        """Files of chosen frames, by folder and frame number; other files and folders are left alone."""
        require_folder(self._source)
        for folder in (LIDAR, CALIBRATION):
            if not (self._source / folder).is_dir():
                raise LogError(f"{self._source}: not an Astyx folder, no {folder}/")
        find = partial(importing.find_numbered, digits=6, frames=self._request.frames)
        files = {folder: find(self._source / folder, (suffix,)) for folder, suffix in _SUFFIXES.items()}
        for folder in (LIDAR, CALIBRATION):
            if not files[folder]:
                path = self._source / folder
                if numbers := importing.find_numbered(path, (_SUFFIXES[folder],), digits=6):
                    raise LogError(
                        f"{path}: no frame {self._request.frames}, there are {min(numbers)} to {max(numbers)}"
                    )
                raise LogError(f"{path}: no frames, expected files like 000001{_SUFFIXES[folder]}")
        return files

    @cached_property
    def _rigs(self) -> Mapping[int, Rig]:
        """The rig of each frame, of the sensors that have files; read before anything else is."""
        files = self._files
        used = [name for name in KINDS if files[name]]
        frames = {number for paths in files.values() for number in paths}
        return read_rigs(files[CALIBRATION], files[CAMERA], used, frames, self._request.bad)

    @property
    def rig(self) -> Rig:
        """That of the first frame. Raises LogError naming the calibration that isn't rigid or lacks a sensor."""
        return self._rigs[min(self._rigs)]

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the set."""
        facts = file_facts(self._source, [path for paths in self._files.values() for path in paths.values()])
        metadata = {
            "dataset": "Astyx HiRes2019",
            "licence": "CC BY-NC-SA 4.0",
            "frames": str(len(self._files[LIDAR])),
            "stamps": "time of the frame's first LiDAR point within the hour, for all sensors: no other is recorded",
            "reference": LIDAR,
            "radar.velocity_period_mps": str(VELOCITY_PERIOD_MPS),
            "radar.rcs_dbsm": "uncalibrated magnitude [dB]",
        }
        return LogInfo(self.name, log_id("astyx", facts, self._request.frames), metadata)

    @property
    def num_items(self) -> int:
        """About a message a file."""
        return sum(len(paths) for paths in self._files.values())

    def items(self) -> Iterator[Message | Truth | RigChange]:
        """All frames that have a LiDAR point; the rig changes where the calibration of a frame isn't the last one."""
        files, bad, rig = self._files, self._request.bad, self.rig
        for number, own in self._rigs.items():
            try:
                sweep = _read_sweep(files[LIDAR][number]) if number in files[LIDAR] else None
            except LogError as error:
                bad.report(error)
                continue
            if sweep is None or not len(sweep):
                self._timeless.append(number)
                continue
            last_us = self._frames[-1][1] // 1000 if self._frames else 0
            stamp_us = last_us // HOUR_US * HOUR_US + int(sweep[0, 5])
            if stamp_us < last_us:
                stamp_us += HOUR_US
                self._turns.append(number)
            self._frames.append((number, stamp_us * 1000))
            if changed := own.list_changes(rig):
                yield RigChange(stamp_us * 1000, own, changed)
                self._changes.append(number)
                rig = own
            for folder in (CAMERA, LIDAR, RADAR, TRUTH):
                if number in files[folder]:
                    try:
                        message = self._message(folder, number, stamp_us * 1000, sweep)
                    except LogError as error:
                        bad.report(error)
                        continue
                    yield message
            self._num_unlabeled += number not in files[TRUTH]
        if not self._frames:
            raise LogError(f"{self._source / LIDAR}: no frame has a LiDAR point, and so none has a time")

    def _message(self, folder: str, number: int, stamp_ns: int, sweep: Float64) -> Message | Truth:
        path = self._files[folder][number]
        if folder == CAMERA:
            return read_jpeg(path, stamp_ns, self._rigs[number].cameras[CAMERA].size_wh, number)
        if folder == TRUTH:
            boxes = read_boxes(path)
            truth = Truth(stamp_ns, stamp_ns, boxes, frame_number=number)
            self._classes.update(() if boxes.source_label is None else boxes.source_label.tolist())
            return truth
        if folder == RADAR:
            table = _read_table(path, "X Y Z V_r Mag").astype(np.float32)
            # V_r is positive when approaching. Shown by the recording: static scenery fits V_r = v cos(azimuth)
            # cos(elevation), modulo the period, with the forward speed v that LiDAR sweeps 0.1 s apart give.
            receding = np.float32(0) - table[:, 3]
            return RadarScan(RADAR, stamp_ns, stamp_ns, table[:, :3], receding, table[:, 4], frame_number=number)
        # The hour can turn within a sweep.
        time_us = sweep[:, 5].astype(np.int64)
        offset_us = (time_us - time_us[0] + HOUR_US // 2) % HOUR_US - HOUR_US // 2
        if np.abs(offset_us).max() * 1000 >= 2**31:
            raise LogError(f"{path}: points more than 2 s apart, expected one sweep")
        xyz, intensity = sweep[:, :3].astype(np.float32), sweep[:, 3].astype(np.float32)
        offset_ns = (offset_us * 1000).astype(np.int32)
        return PointCloud(LIDAR, stamp_ns, stamp_ns, xyz, intensity, sweep[:, 4].astype(np.uint16), offset_ns, number)

    def summary(self) -> Sequence[str]:
        """What was found."""
        frames, files = self._frames, self._files
        gaps = [i for i in range(1, len(frames)) if frames[i][1] - frames[i - 1][1] > GAP_NS]
        parts = [frames[a:b] for a, b in pairwise([0, *gaps, len(frames)])]
        spacing_s = [(b[1] - a[1]) / 1e9 for part in parts for a, b in pairwise(part)]
        spread = f", spaced by {min(spacing_s):.2f} to {max(spacing_s):.2f} s" if spacing_s else ""
        plural = "es" if gaps else ""
        lines = [f"frames: {len(frames)} in {len(parts)} stretch{plural} (parted by gaps of over 2 s){spread}"]
        for part in parts[:_LISTED]:
            seconds = (part[-1][1] - part[0][1]) / 1e9
            lines.append(f"stretch: frames {part[0][0]} to {part[-1][0]} ({len(part)}), {seconds:.1f} s")
        if len(parts) > _LISTED:
            lines.append(f"stretch: {len(parts) - _LISTED} more")
        expected = (CAMERA, RADAR, CALIBRATION, TRUTH)
        counts = [(folder, sum(number not in files[folder] for number, _ in frames)) for folder in expected]
        lines.append(f"missing files: {', '.join(f'{folder} {num}' for folder, num in counts if num) or 'none'}")
        if self._changes:
            numbers = importing.format_list(self._changes, _LISTED)
            lines.append(f"calibration changes before frames {numbers}: a new segment begins there")
        if self._timeless:
            numbers = importing.format_list(self._timeless, _LISTED)
            lines.append(f"left out, without LiDAR points and so without time: frames {numbers}")
        classes = importing.format_counts(self._classes)
        lines.append(f"boxes: {self._classes.total()}{f' ({classes})' if classes else ''}, without track ids")
        if self._num_unlabeled:
            lines.append(f"unlabeled frames: {self._num_unlabeled}")
        if unknown := sorted(self._classes.keys() - LABELS.keys()):
            lines.append(f"classes that the set's specification lacks, taken as 'other': {', '.join(unknown)}")
        if self._turns:
            numbers = importing.format_list(self._turns, _LISTED)
            lines.append(f"time ran backwards before frames {numbers}: whole hours were added")
        return [
            *lines,
            "stamps: all messages of a frame have the LiDAR's, the set records no time for camera, radar and boxes",
            f"radar: velocities are ambiguous, they alias with a period of {VELOCITY_PERIOD_MPS} m/s",
            "radar: rcs holds an uncalibrated magnitude [dB]",
        ]


def read_jpeg(path: Path, stamp_ns: int, size_wh: tuple[int, int] | None = None, number: int | None = None) -> Image:
    """Return an image, which must be `size_wh` [px] where that is given. Raises LogError naming the file."""
    image = importing.read_image(path, CAMERA, stamp_ns, frame_number=number)
    if image.encoding != "jpeg":
        raise LogError(f"{path}: not a JPEG image")
    size = image.size_wh
    if size_wh is not None and size != size_wh:
        raise LogError(f"{path}: {size[0]}x{size[1]} px, expected {size_wh[0]}x{size_wh[1]} as in the first image")
    return image


def read_boxes(path: Path) -> Boxes3D:
    """Read the objects of one frame, in body coordinates.

    `label_certainty`, `measured_by` and `created_by` are dropped; `object_id` and `score` are always -1. Raises
    LogError naming file and field.
    """
    objects = importing.read_json(path, Objects).objects
    for w, x, y, z in (o.orientation_quat for o in objects):
        if abs(w * w + x * x + y * y + z * z - 1) > 1e-3:  # They are written with few digits
            raise LogError(f"{path}: orientation_quat isn't a unit quaternion: {w} {x} {y} {z}")
    xyzw = [(x, y, z, w) for w, x, y, z in (o.orientation_quat for o in objects)]
    angles = np.array([yaw_pitch_roll(quaternion) for quaternion in xyzw]).reshape(-1, 3)
    return Boxes3D(
        center_m=np.array([o.center3d for o in objects]).reshape(-1, 3),
        size_lwh_m=np.array([o.dimension3d for o in objects]).reshape(-1, 3),
        yaw_rad=angles[:, 0],
        pitch_rad=angles[:, 1],
        roll_rad=angles[:, 2],
        label=np.array([LABELS.get(o.classname, "other") for o in objects], dtype=np.str_),
        occlusion=np.array([o.occlusion for o in objects], dtype=np.float64),
        source_label=np.array([o.classname for o in objects], dtype=np.str_),
    )


def _read_sweep(path: Path) -> Float64:
    """Points (N, 6) of one file of `lidar_vlp16/`: x, y, z [m], reflectivity, ring and time within the hour [us]."""
    table = _read_table(path, "X Y Z Reflectivity LaserID Timestamp")
    ring, time_us = table[:, 4], table[:, 5]
    if not (np.all((ring >= 0) & (ring < 2**16)) and np.all((time_us >= 0) & (time_us < HOUR_US))):
        raise LogError(f"{path}: expected LaserID from 0 to 65535 and Timestamp within one hour [us]")
    return table


def _read_table(path: Path, header: str) -> Float64:
    """Numbers (N, columns) under a header, above which some files have an empty line."""
    data, names = read_bytes(path), header.encode().split()
    top, _, body = data.lstrip().partition(b"\n")
    if top.split() == names:
        columns = [str(i) for i in range(len(names))]
        with suppress(pa.ArrowInvalid):  # anything but numbers with one space between them
            table = csv.read_csv(
                pa.BufferReader(body),
                csv.ReadOptions(block_size=_BLOCK, column_names=columns),
                csv.ParseOptions(delimiter=" ", quote_char=False),
                csv.ConvertOptions(column_types=dict.fromkeys(columns, pa.float64()), null_values=[]),
            )
            return np.column_stack([column.to_numpy() for column in table.columns])
    lines = [(i, row) for i, line in enumerate(data.splitlines(), 1) if (row := line.split())]
    if not lines or lines[0][1] != names:
        raise LogError(f"{path}: line {lines[0][0] if lines else 1}: expected the header '{header}'")
    values = []
    for i, texts in lines[1:]:
        try:
            values.append([float(text) for text, _ in zip(texts, names, strict=True)])
        except ValueError as error:
            raise LogError(f"{path}: line {i}: expected {len(names)} numbers") from error
    return np.array(values, np.float64).reshape(-1, len(names))
