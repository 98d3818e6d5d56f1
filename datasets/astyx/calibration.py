"""Calibration of the Astyx set: a file a frame, and the rig that each frame has."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
from pydantic import BaseModel, FiniteFloat

from fbench.datasets.importing import files as importing
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput
from fbench.replay.data.rig import CameraModel, Kind, Rig

CAMERA, LIDAR, RADAR = "camera_front", "lidar_vlp16", "radar_6455"
KINDS: dict[str, Kind] = {CAMERA: "camera", LIDAR: "lidar", RADAR: "radar"}
_Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Four = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class CalibData(BaseModel, frozen=True):
    """Calibration of one sensor; `K` belongs to cameras only."""

    T_to_ref_COS: tuple[_Four, _Four, _Four, _Four]
    K: tuple[_Three, _Three, _Three] | None = None


class Sensor(BaseModel, frozen=True):
    """One sensor of a calibration file."""

    sensor_uid: str
    calib_data: CalibData


class Calibration(BaseModel, frozen=True):
    """One file of `calibration/`."""

    sensors: tuple[Sensor, ...]


_Used = tuple[tuple[str, CalibData], ...]  # By sensor, of those that have files


def read_rigs(
    paths: Mapping[int, Path], images: Mapping[int, Path], sensors: Collection[str], frames: Collection[int],
    bad: BadInput,
) -> Mapping[int, Rig]:  # fmt: skip
    """Return the rig of each frame, in the set's reference frame, that of the radar; equal ones are one object.

    A frame without a file has the calibration of its neighbors, where these have the same. Frames whose calibration
    can't be used are reported, and left out.

    Args:
        paths: Calibration files by frame number, at least one.
        images: Images by frame number; those of one calibration have one size, that of the first one.
        sensors: Names of the sensors that have files.
        frames: Numbers of all frames.
        bad: Counts what can't be used.

    Raises:
        LogError: naming the file that can't be read, isn't rigid or lacks a sensor.
    """
    used = dict(_read_used(paths, sensors, bad))
    rigs: dict[_Used, Rig] = {}
    found: dict[int, Rig] = {}
    for number in sorted(frames):
        try:
            calibration = used[number] if number in used else _neighbor(number, paths, used)
            if calibration is None:
                continue
            if calibration not in rigs:
                own = [images[n] for n in sorted(images) if used.get(n) == calibration]
                size_wh = _first_size([*own, *(images[n] for n in sorted(images))], bad)
                rigs[calibration] = _make_rig(calibration, size_wh, paths.get(number, next(iter(paths.values()))))
            found[number] = rigs[calibration]
        except LogError as error:
            bad.report(error)
    if not found:
        raise LogError(f"{next(iter(paths.values())).parent}: no frame has a calibration that can be used")
    return found


def _read_used(paths: Mapping[int, Path], sensors: Collection[str], bad: BadInput) -> Iterator[tuple[int, _Used]]:
    for number, path in sorted(paths.items()):
        try:
            data = {s.sensor_uid: s.calib_data for s in importing.read_json(path, Calibration).sensors}
            for name in sensors:
                if name not in data:
                    raise LogError(f"{path}: no sensor '{name}'")
        except LogError as error:
            bad.report(error)
            continue
        yield number, tuple((name, data[name]) for name in sensors)


def _neighbor(number: int, paths: Mapping[int, Path], used: Mapping[int, _Used]) -> _Used | None:
    """Return the calibration of the frames beside one that has no file; `None`: the file is there, but can't be used.
    Raises LogError where it isn't the same before and after.
    """
    if number in paths:
        return None
    before = max((n for n in used if n < number), default=None)
    after = min((n for n in used if n > number), default=None)
    sides = [n for n in (before, after) if n is not None]
    if not sides:
        return None
    if used[sides[0]] != used[sides[-1]]:
        folder = next(iter(paths.values())).parent
        which = f"frames {sides[0]} and {sides[-1]} have different ones"
        raise LogError(f"{folder}: frame {number} has no calibration, and {which}")
    return used[sides[0]]


def _first_size(images: Collection[Path], bad: BadInput) -> tuple[int, int] | None:
    """Size [px] of the first image that can be read; `None` without any."""
    for path in images:
        try:
            return importing.read_image(path, CAMERA, 0).size_wh
        except LogError:
            if not bad.skip:  # else it is met, and counted, with its frame
                raise
    return None


def _make_rig(calibration: _Used, size_wh: tuple[int, int] | None, path: Path) -> Rig:
    mounts, cameras = {}, {}
    for name, data in calibration:
        matrix = np.array(data.T_to_ref_COS)
        if not importing.is_rotation(matrix[:3, :3]):
            why = "isn't a rotation, its columns must be orthonormal within 1e-3"
            raise LogError(f"{path}: {name}: T_to_ref_COS {why}")
        mounts[name] = importing.mount_of(KINDS[name], matrix)
        if KINDS[name] == "camera" and size_wh is not None:
            if data.K is None:
                raise LogError(f"{path}: {name}: no K")
            cameras[name] = CameraModel(np.array(data.K), size_wh)
    return Rig(mounts, cameras)
