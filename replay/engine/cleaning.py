"""Removal of what must never reach a pipeline, and checks of what it returns."""

from bisect import bisect_left, bisect_right, insort
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple, get_args

import numpy as np

from fbench.replay.contracts.errors import DataError, did_you_mean
from fbench.replay.contracts.faults import FAULTS, FaultLog
from fbench.replay.data.arrays import Float32, own_arrays
from fbench.replay.data.boxes import LABELS, MAX_BOXES, MAX_MAGNITUDE, Boxes, Boxes2D, Boxes3D, most_boxes
from fbench.replay.data.frames import ClockName, Fault, Output
from fbench.replay.data.messages import Image, Message, Pose, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.logs.codecs.packed_points import only_finite
from fbench.replay.logs.coordinate_frames import invalid


class Skipped(NamedTuple):
    """A message that can't be used."""

    sensor: str
    stamp_ns: int
    frame_number: int | None
    reason: str


class SkippedMessages:
    """Keeps them so that finding one is quick in a long log, up to `tolerance_ns` from the instant of its frame."""

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._by_number: dict[tuple[str, int], Skipped] = {}
        self._by_stamp: dict[str, list[Skipped]] = {}

    def add(self, message: Skipped) -> None:
        """Keep one message."""
        if message.frame_number is not None:
            self._by_number[message.sensor, message.frame_number] = message
        insort(self._by_stamp.setdefault(message.sensor, []), message, key=attrgetter("stamp_ns"))

    def reason(self, sensor: str, stamp_ns: int, frame_number: int | None) -> str | None:
        """Why a frame's message was skipped, if one was: by frame number where both have one, else by nearest stamp."""
        if frame_number is not None and (found := self._by_number.get((sensor, frame_number))):
            return found.reason
        messages = self._by_stamp.get(sensor, [])
        first = bisect_left(messages, stamp_ns - self._tolerance_ns, key=attrgetter("stamp_ns"))
        stop = bisect_right(messages, stamp_ns + self._tolerance_ns, key=attrgetter("stamp_ns"))
        near = [m for m in messages[first:stop] if frame_number is None or m.frame_number is None]
        return min(near, key=lambda m: abs(m.stamp_ns - stamp_ns)).reason if near else None


MAX_LOST_SHARE = 0.5  # A cloud with a larger share of non-finite points is skipped whole
MAX_RANGE_M = 1000.0  # Points farther away are taken as they are, but no sensor of a vehicle sees so far


def clean(message: Message, rig: Rig, faults: FaultLog) -> Message | Skipped:
    """Drop and count non-finite points, clouds mostly of such, images of a wrong size or of a video that was broken
    off, and poses that are invalid.
    """
    where = f"{message.sensor} at {message.stamp_ns} ns"
    if isinstance(message, Image):
        if message.video is not None and (damage := message.video.damage):
            faults.add("DEC004" if message.video.is_lost else "DEC005", f"{where}: {damage}")
            return Skipped(message.sensor, message.stamp_ns, message.frame_number, f"video {damage}")
        camera = rig.cameras.get(message.sensor)
        if camera is None or camera.size_wh == message.size_wh:
            return message
        (width, height), (w, h) = message.size_wh, camera.size_wh
        reason = f"{width}x{height}, but calibrated for {w}x{h}"
        faults.add("LIM003", f"{where}: {reason}")
        return Skipped(message.sensor, message.stamp_ns, message.frame_number, reason)
    if isinstance(message, Pose):
        if (why := invalid(message.translation_m, message.rotation_xyzw)) is None:
            return message
        faults.add("DAT005", f"{where}: {why}")
        return Skipped(message.sensor, message.stamp_ns, message.frame_number, f"pose {why}")
    num = len(message.xyz)
    if num == 0:
        faults.add("DAT002", where)
        return message
    finite = only_finite(message)
    if lost := num - len(finite.xyz):
        is_most = lost > MAX_LOST_SHARE * num
        faults.add("DAT001" if is_most else "DAT004", f"{where}: {lost} of {num} points")
        if is_most:
            return Skipped(message.sensor, message.stamp_ns, message.frame_number, "mostly non-finite points")
    if max(float(finite.xyz.max()), -float(finite.xyz.min())) > MAX_RANGE_M:
        far = int(np.count_nonzero((np.abs(finite.xyz) > MAX_RANGE_M).any(axis=1)))
        faults.add("DAT003", f"{where}: {far} of {len(finite.xyz)} points")
    return _drop_infinite(finite, where, faults) if isinstance(finite, RadarScan) else finite


def _drop_infinite(scan: RadarScan, where: str, faults: FaultLog) -> RadarScan:
    """Take infinite velocities and magnitudes of echoes as not measured; drivers write NaN for those."""

    def known(name: str, values: Float32 | None) -> Float32 | None:
        if values is None or not (bad := np.abs(values) >= MAX_MAGNITUDE).any():
            return values
        faults.add("DAT006", f"{where}: {name} of {np.count_nonzero(bad)} of {len(values)} echoes")
        return np.where(bad, np.float32(np.nan), values)

    velocity = known("radial_velocity_mps", scan.radial_velocity_mps)
    strength = known("rcs_dbsm", scan.rcs_dbsm)
    is_same = velocity is scan.radial_velocity_mps and strength is scan.rcs_dbsm
    return scan if is_same else replace(scan, radial_velocity_mps=velocity, rcs_dbsm=strength)


_MAX_SHOWN = 200


def _short(value: object) -> str:
    text = repr(value)  # of a plug-in, which may make it as long as it likes
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]} ..."


def check_faults(where: str, faults: Sequence[object]) -> None:
    """Refuse what isn't a fault of the table. Raises DataError saying what."""
    for fault in faults:
        if not isinstance(fault, Fault) or fault.code not in FAULTS:
            raise DataError(f"{where}: {_short(fault)} isn't a fault of the table")


class OutputCheck:
    """Checks outputs of one run: their types, names that exist, and one kind of boxes throughout."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = tuple(sorted({*rig.cameras, *rig.sensors("camera")}))
        self._kind: type[Boxes] | None = None

    def __call__(self, output: object) -> Output:
        """Return the output with arrays of its own. Raises DataError: saying what is wrong."""
        if not isinstance(output, Output):
            raise DataError(f"step() gave {type(output).__name__}, expected Output")
        self._check_boxes("Output.detections", output.detections)
        if output.tracks is not None:
            self._check_boxes("Output.tracks", output.tracks)
        self._kind = type(output.detections)
        texts: Mapping[Any, Any] = dict(output.missing)
        for key, value in texts.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise DataError(f"Output.missing: expected texts, got {_short(key)}: {_short(value)}")
        for field, given in (("stage_ns", output.stage_ns), ("cpu_ns", output.cpu_ns)):
            times: Mapping[Any, Any] = dict(given)
            for stage, ns in times.items():
                if not isinstance(stage, str) or not isinstance(ns, int | np.integer) or ns < 0:
                    raise DataError(f"Output.{field}: expected names and times [ns], got {_short(stage)}: {_short(ns)}")
        if output.clock not in get_args(ClockName):
            raise DataError(f"Output.clock: expected {' or '.join(get_args(ClockName))}, got {_short(output.clock)}")
        check_faults("Output.faults", output.faults)
        return own_arrays(output)

    def _check_boxes(self, where: str, boxes: object) -> None:
        got = type(boxes).__name__
        if not isinstance(boxes, Boxes2D | Boxes3D):
            raise DataError(f"{where}: expected Boxes2D or Boxes3D, got {got}")
        if self._kind is not None and type(boxes) is not self._kind:
            raise DataError(f"{where}: expected {self._kind.__name__} as in other frames, got {got}")
        if (num := most_boxes(boxes)) > MAX_BOXES:
            place = "" if isinstance(boxes, Boxes3D) else " in one image"
            raise DataError(
                f"{where}: {num} boxes{place}, more than {MAX_BOXES}; give only those with the highest scores"
            )
        cameras = boxes.camera.tolist() if isinstance(boxes, Boxes2D) else []
        labels = [] if boxes.label is None else boxes.label.tolist()
        known: Sequence[str]
        for field, names, known in (("label", labels, ("", *LABELS)), ("camera", cameras, self._cameras)):
            for name in names:
                if name not in known:
                    raise DataError(f"{where}.{field}: {_short(name)} isn't known{did_you_mean(name, known)}")
