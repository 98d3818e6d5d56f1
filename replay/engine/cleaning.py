"""Removal of what must never reach a pipeline, and checks of what it returns."""

from bisect import bisect_left, bisect_right, insort
from collections.abc import Mapping
from typing import NamedTuple, get_args

import numpy as np

from fbench.replay.contracts.errors import DataError, did_you_mean
from fbench.replay.contracts.faults import FAULTS, FaultLog
from fbench.replay.data.arrays import Float32, own_arrays
from fbench.replay.data.boxes import LABELS, Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import ClockName, Fault, Output
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.logs.codecs.points import C, only_finite
from fbench.replay.logs.coordinate_frames import invalid


class Skipped(NamedTuple):
    """A message that can't be used."""

    sensor: str
    stamp_ns: int
    frame_number: int | None
    reason: str


class SkippedMessages:
    """Keeps them so that finding one takes no longer in a long log.

    Args:
        tolerance_ns: How far a stamp may be from the instant of its frame [ns].
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._by_number: dict[tuple[str, int], Skipped] = {}
        self._by_stamp: dict[str, list[Skipped]] = {}

    def add(self, message: Skipped) -> None:
        """Keep one message."""
        if message.frame_number is not None:
            self._by_number[message.sensor, message.frame_number] = message
        insort(self._by_stamp.setdefault(message.sensor, []), message, key=_stamp_ns)

    def reason(self, sensor: str, stamp_ns: int, frame_number: int | None) -> str | None:
        """Why the sensor's message of this frame was skipped; `None` where there was none: by frame number where both
        have one, else by nearest stamp.
        """
        if frame_number is not None and (found := self._by_number.get((sensor, frame_number))):
            return found.reason
        messages = self._by_stamp.get(sensor, [])
        first = bisect_left(messages, stamp_ns - self._tolerance_ns, key=_stamp_ns)
        stop = bisect_right(messages, stamp_ns + self._tolerance_ns, key=_stamp_ns)
        near = [m for m in messages[first:stop] if frame_number is None or m.frame_number is None]
        return min(near, key=lambda m: abs(m.stamp_ns - stamp_ns)).reason if near else None


def _stamp_ns(message: Skipped) -> int:
    return message.stamp_ns


MAX_LOST_SHARE = 0.5  # A cloud with a larger share of non-finite points is skipped whole
MAX_RANGE_M = 1000.0  # Points farther away are taken as they are, but no sensor of a vehicle sees so far


def clean(message: Message, rig: Rig, faults: FaultLog) -> Message | Skipped:
    """Drop points with a non-finite coordinate, clouds that consist mostly of them, images of another size than their
    camera's, and poses that aren't finite or have no rotation; count all of these.
    """
    if isinstance(message, PointCloud):
        return _clean_cloud(message, faults)
    if isinstance(message, RadarScan):
        return _clean_cloud(message, faults)
    if isinstance(message, Image):
        return _clean_image(message, rig, faults)
    if (why := invalid(message.translation_m, message.rotation_xyzw)) is not None:
        faults.add("DAT005", f"{message.sensor} at {message.stamp_ns} ns: {why}")
        return Skipped(message.sensor, message.stamp_ns, message.frame_number, f"pose {why}")
    return message


def _clean_image(image: Image, rig: Rig, faults: FaultLog) -> Image | Skipped:
    camera = rig.cameras.get(image.sensor)
    if camera is None or camera.size_wh == image.size_wh:
        return image
    (width, height), (w, h) = image.size_wh, camera.size_wh
    reason = f"{width}x{height}, but calibrated for {w}x{h}"
    faults.add("LIM003", f"{image.sensor} at {image.stamp_ns} ns: {reason}")
    return Skipped(image.sensor, image.stamp_ns, image.frame_number, reason)


def _clean_cloud(cloud: C, faults: FaultLog) -> C | Skipped:
    where = f"{cloud.sensor} at {cloud.stamp_ns} ns"
    num = len(cloud.xyz)
    if num == 0:
        faults.add("DAT002", where)
        return cloud
    if np.isfinite(cloud.xyz).all():
        _flag_far(where, cloud.xyz, faults)
        return cloud
    finite = only_finite(cloud)
    lost = num - len(finite.xyz)
    if lost > MAX_LOST_SHARE * num:
        faults.add("DAT001", f"{where}: {lost} of {num} points")
        return Skipped(cloud.sensor, cloud.stamp_ns, cloud.frame_number, "mostly non-finite points")
    faults.add("DAT004", f"{where}: {lost} of {num} points")
    _flag_far(where, finite.xyz, faults)
    return finite


def _flag_far(where: str, xyz: Float32, faults: FaultLog) -> None:
    if max(float(xyz.max()), -float(xyz.min())) > MAX_RANGE_M:
        num = int(np.count_nonzero((np.abs(xyz) > MAX_RANGE_M).any(axis=1)))
        faults.add("DAT003", f"{where}: {num} of {len(xyz)} points")


class OutputCheck:
    """Checks outputs of one run: their types, names that exist, and one kind of boxes throughout."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = tuple(sorted(rig.cameras))
        self._kind: type[Boxes] | None = None

    def __call__(self, output: object) -> Output:
        """Return the output with arrays of its own. Raises DataError: saying what is wrong."""
        if not isinstance(output, Output):
            raise DataError(f"step() gave {type(output).__name__}, expected Output")
        for name, boxes in (("detections", output.detections), ("tracks", output.tracks)):
            self._check_boxes(name, boxes)
        self._kind = type(output.detections)
        _check_texts("missing", dict(output.missing))
        _check_times(dict(output.stage_ns))
        if output.clock not in get_args(ClockName):
            raise DataError(f"Output.clock: expected {' or '.join(get_args(ClockName))}, got {output.clock!r}")
        for fault in output.faults:
            if not isinstance(fault, Fault) or fault.code not in FAULTS:
                raise DataError(f"Output.faults: {fault!r} isn't a fault of the table")
        return own_arrays(output)

    def _check_boxes(self, name: str, boxes: object) -> None:
        if not isinstance(boxes, Boxes2D | Boxes3D):
            raise DataError(f"Output.{name}: expected Boxes2D or Boxes3D, got {type(boxes).__name__}")
        if self._kind is not None and type(boxes) is not self._kind:
            raise DataError(
                f"Output.{name}: expected {self._kind.__name__} as in other frames, got {type(boxes).__name__}"
            )
        if boxes.label is not None:
            _check_names(f"Output.{name}.label", boxes.label.tolist(), ("", *LABELS))
        if isinstance(boxes, Boxes2D):
            _check_names(f"Output.{name}.camera", boxes.camera.tolist(), self._cameras)


def _check_names(where: str, names: list[str], known: tuple[str, ...]) -> None:
    for name in names:
        if name not in known:
            raise DataError(f"{where}: '{name}' isn't known{did_you_mean(name, known)}")


def _check_texts(where: str, texts: Mapping[str, object]) -> None:
    for key, value in texts.items():
        if not isinstance(key, str) or not isinstance(value, str):
            raise DataError(f"Output.{where}: expected texts, got {key!r}: {value!r}")


def _check_times(stage_ns: Mapping[str, object]) -> None:
    for stage, ns in stage_ns.items():
        if not isinstance(stage, str) or not isinstance(ns, int | np.integer) or ns < 0:
            raise DataError(f"Output.stage_ns: expected names and times [ns], got {stage!r}: {ns!r}")
