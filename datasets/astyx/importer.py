"""Importer of the Astyx HiRes2019 set: one camera, a VLP-16 LiDAR, a 3D radar and 3D boxes.

M. Meyer and G. Kuschk, "Automotive Radar Dataset for Deep Learning Based 3D Object Detection", EuRAD 2019.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from fbench.datasets.astyx.files import (
    CALIBRATION,
    CAMERA,
    HOUR_US,
    KINDS,
    LABELS,
    LIDAR,
    RADAR,
    TRUTH,
    Files,
    LidarTable,
    read_boxes,
    read_jpeg,
    read_lidar,
    read_radar,
    read_rig,
    scan,
)
from fbench.datasets.importing.files import format_counts, format_list
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput, ImportWish, file_facts, log_id, require_folder
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig

VELOCITY_PERIOD_MPS = 10.3936
"""The radar's velocities come in 128 bins of 0.0812 m/s; faster ones alias with this period."""
GAP_NS = 2_000_000_000
_LISTED = 20


@dataclass
class _Findings:
    """What the import met, for its summary."""

    frames: list[tuple[int, int]] = field(default_factory=list)  # Number and stamp [ns] of each frame
    timeless: list[int] = field(default_factory=list)
    turns: list[int] = field(default_factory=list)  # Frames before which the clock ran backwards
    boxes: Counter[str] = field(default_factory=Counter)
    unlabeled: int = 0

    def add(self, message: Message | Truth) -> None:
        """Count the boxes of truth."""
        boxes = message.boxes3d if isinstance(message, Truth) else None
        if boxes is not None and boxes.source_label is not None:
            self.boxes.update(boxes.source_label.tolist())


class Astyx:
    """Reads `camera_front/ lidar_vlp16/ radar_6455/ calibration/ groundtruth_obj3d/`, files named by frame number.

    The folder is one sequence.
    """

    def names(self, source: Path) -> Sequence[str]:
        """Name of the folder; see `Importer`."""
        require_folder(source)
        return [source.resolve().name]

    def recordings(self, source: Path, wish: ImportWish) -> Iterator["AstyxRecording"]:
        """Open the folder; see `Importer`."""
        for name in wish.names:
            yield AstyxRecording(name, source, wish)


class AstyxRecording:
    """One folder; see `Recording`.

    Time exists in the LiDAR's files only: the first point's time is the stamp of all messages of the frame. It
    counts within the hour; where it runs backwards from one frame to the next, whole hours are added.
    """

    def __init__(self, name: str, source: Path, wish: ImportWish) -> None:
        self.name, self._source, self._wish = name, source, wish
        self._findings = _Findings()

    @cached_property
    def _files(self) -> Files:
        return scan(self._source, self._wish.frames)

    @cached_property
    def rig(self) -> Rig:
        """Sensors and calibration; body coordinates are the set's reference frame, that of the radar."""
        return read_rig(self._files)

    @cached_property
    def info(self) -> LogInfo:
        """Facts of the set."""
        files = self._files
        facts = file_facts(self._source, [path for paths in files.values() for path in paths.values()])
        metadata = {
            "dataset": "Astyx HiRes2019",
            "licence": "CC BY-NC-SA 4.0",
            "frames": str(len(files[LIDAR])),
            "stamps": "time of the frame's first LiDAR point within the hour, for all sensors: no other is recorded",
            "reference": LIDAR,
            "radar.velocity_period_mps": str(VELOCITY_PERIOD_MPS),
            "radar.rcs_dbsm": "uncalibrated magnitude [dB]",
        }
        return LogInfo(self.name, log_id("astyx", facts, self._wish.frames), metadata)

    @property
    def num_items(self) -> int:
        """About a message a file."""
        return sum(len(paths) for paths in self._files.values())

    def items(self) -> Iterator[Message | Truth]:
        """All frames that have a LiDAR point."""
        yield from _messages(self._files, self.rig, self._findings, self._wish.bad)
        if not self._findings.frames:
            raise LogError(f"{self._source / LIDAR}: no frame has a LiDAR point, and so none has a time")

    def summary(self) -> Sequence[str]:
        """What was found."""
        return _summary(self._files, self._findings)


def _messages(files: Files, rig: Rig, findings: _Findings, bad: BadInput) -> Iterator[Message | Truth]:
    for number in sorted({number for paths in files.values() for number in paths}):
        try:
            lidar = read_lidar(files[LIDAR][number]) if number in files[LIDAR] else None
        except LogError as error:
            bad.report(error)
            continue
        if lidar is None or not len(lidar.time_us):
            findings.timeless.append(number)
            continue
        stamp_ns = _stamp(int(lidar.time_us[0]), number, findings)
        findings.frames.append((number, stamp_ns))
        for folder in (CAMERA, LIDAR, RADAR, TRUTH):
            if number in files[folder]:
                try:
                    message = _message(folder, files[folder][number], rig, number, stamp_ns, lidar)
                except LogError as error:
                    bad.report(error)
                    continue
                yield message
                findings.add(message)
        findings.unlabeled += number not in files[TRUTH]


def _stamp(time_us: int, number: int, findings: _Findings) -> int:
    last_us = findings.frames[-1][1] // 1000 if findings.frames else 0
    hours = last_us // HOUR_US
    if hours * HOUR_US + time_us < last_us:
        hours += 1
        findings.turns.append(number)
    return (hours * HOUR_US + time_us) * 1000


def _message(
    folder: str, path: Path, rig: Rig, number: int, stamp_ns: int, lidar: LidarTable
) -> Image | PointCloud | RadarScan | Truth:
    if folder == CAMERA:
        return read_jpeg(path, stamp_ns, rig.cameras[CAMERA].size_wh, number)
    if folder == TRUTH:
        return Truth(stamp_ns, stamp_ns, read_boxes(path), frame_number=number)
    if folder == RADAR:
        table = read_radar(path).astype(np.float32)
        # V_r is positive when approaching. Shown by the recording: static scenery fits V_r = v cos(azimuth)
        # cos(elevation), modulo the period, with the forward speed v that LiDAR sweeps 0.1 s apart give.
        receding = np.float32(0) - table[:, 3]
        return RadarScan(RADAR, stamp_ns, stamp_ns, table[:, :3], receding, table[:, 4], frame_number=number)
    # The hour can turn within a sweep.
    offset_us = (lidar.time_us - lidar.time_us[0] + HOUR_US // 2) % HOUR_US - HOUR_US // 2
    if np.abs(offset_us).max() * 1000 >= 2**31:
        raise LogError(f"{path}: points more than 2 s apart, expected one sweep")
    return PointCloud(
        LIDAR, stamp_ns, stamp_ns, lidar.xyz.astype(np.float32), lidar.intensity.astype(np.float32),
        lidar.ring.astype(np.uint16), (offset_us * 1000).astype(np.int32), number,
    )  # fmt: skip


def _summary(files: Files, findings: _Findings) -> list[str]:
    lines = [*_stretch_lines(findings.frames), *_missing_lines(files, findings), *_box_lines(findings)]
    if findings.turns:
        lines.append(f"time ran backwards before frames {format_list(findings.turns, _LISTED)}: whole hours were added")
    return [
        *lines,
        "stamps: all messages of a frame have the LiDAR's, the set records no time for camera, radar and boxes",
        f"radar: velocities are ambiguous, they alias with a period of {VELOCITY_PERIOD_MPS} m/s",
        "radar: rcs holds an uncalibrated magnitude [dB]",
    ]


def _stretch_lines(frames: list[tuple[int, int]]) -> Iterator[str]:
    gaps = [i for i in range(1, len(frames)) if frames[i][1] - frames[i - 1][1] > GAP_NS]
    stretches = [frames[a:b] for a, b in pairwise([0, *gaps, len(frames)])]
    spacing_s = [(b[1] - a[1]) / 1e9 for part in stretches for a, b in pairwise(part)]
    spread = f", spaced by {min(spacing_s):.2f} to {max(spacing_s):.2f} s" if spacing_s else ""
    plural = "es" if gaps else ""
    yield f"frames: {len(frames)} in {len(stretches)} stretch{plural} (parted by gaps of over 2 s){spread}"
    for part in stretches[:_LISTED]:
        yield f"stretch: frames {part[0][0]} to {part[-1][0]} ({len(part)}), {(part[-1][1] - part[0][1]) / 1e9:.1f} s"
    if len(stretches) > _LISTED:
        yield f"stretch: {len(stretches) - _LISTED} more"


def _missing_lines(files: Files, findings: _Findings) -> Iterator[str]:
    numbers = [number for number, _ in findings.frames]
    folders = [*(name for name in KINDS if name != LIDAR), CALIBRATION, TRUTH]
    counts = {folder: sum(number not in files[folder] for number in numbers) for folder in folders}
    yield "missing files: " + (", ".join(f"{folder} {count}" for folder, count in counts.items() if count) or "none")
    if findings.timeless:
        yield f"left out, without LiDAR points and so without time: frames {format_list(findings.timeless, _LISTED)}"


def _box_lines(findings: _Findings) -> Iterator[str]:
    classes = format_counts(findings.boxes)
    yield f"boxes: {findings.boxes.total()}{f' ({classes})' if classes else ''}, without track ids"
    if findings.unlabeled:
        yield f"unlabeled frames: {findings.unlabeled}"
    unknown = sorted(name for name in findings.boxes if name not in LABELS)
    if unknown:
        yield f"classes that the set's specification lacks, taken as 'other': {', '.join(unknown)}"
