"""Boxes of a file moved into body coordinates, or left in those of the world."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fbench.replay.contracts.errors import ConfigError, DecodeError, LogError, did_you_mean
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import moved
from fbench.replay.logs.coordinate_frames import WORLDS, CoordinateFrames
from fbench.replay.logs.setup import BoxSource


def place(boxes: Boxes3D, frames: Sequence[str], coordinates: CoordinateFrames, where: str) -> tuple[Boxes3D, bool]:
    """Return boxes, each in its own one of `frames`, in body coordinates; or all in those of the world, and say so.

    Raises:
        ConfigError: where a coordinate frame isn't known.
        LogError: where some boxes are in the world and some aren't.
    """
    names = list(dict.fromkeys(frames))
    worlds = [name for name in names if coordinates.is_world(name)]
    if worlds and len(worlds) < len(names):
        other = next(name for name in names if name not in worlds)
        raise LogError(f"{where}: boxes in '{worlds[0]}' and in '{other or 'body'}' at one instant; use one of them")
    if worlds:
        return boxes, True
    if len(names) == 1:
        return _in_body(boxes, names[0], coordinates, where), False
    owners = np.array(frames, np.str_)
    parts = [(np.flatnonzero(owners == name), name) for name in names]
    done = [(rows, _in_body(boxes[rows], name, coordinates, where)) for rows, name in parts]
    return (_merge(boxes, done) if done else boxes), False


def body_T(name: str, coordinates: CoordinateFrames, where: str) -> Float64:
    """Return the matrix (4, 4) from a coordinate frame to the body.

    Raises:
        ConfigError: where it isn't known.
    """
    try:
        matrix = coordinates.body_T(name)
    except DecodeError as error:
        raise LogError(f"{where}: coordinate frame '{name}': {error}", "CAL001") from error
    if matrix is None and name in WORLDS:
        advice = f"name a topic with poses in '{name}' as body.pose"
        raise ConfigError(f"{where}: boxes in '{name}', but the log's poses are in '{coordinates.world}'; {advice}")
    if matrix is None:
        raise ConfigError(
            f"{where}: coordinate frame '{name}' isn't in the log{did_you_mean(name, _known(coordinates))}"
        )
    return matrix


def _known(coordinates: CoordinateFrames) -> list[str]:
    """Names of the coordinate frames that boxes may be in."""
    linked = {coordinates.body, *coordinates.rig.mounts, *coordinates.tree.edges}
    return sorted({"body", "world", coordinates.world, *linked} - {""})


def find_camera(name: str, coordinates: CoordinateFrames, where: str) -> str:
    """Return the name of a camera by its name, coordinate frame or topic; of the only one without a name.

    Raises:
        ConfigError: where there is no such camera, or several without a name.
    """
    cameras = coordinates.rig.sensors("camera")
    found = coordinates.camera(name) if name else coordinates.only_camera()
    if found is None and name:
        raise ConfigError(f"{where}: '{name}' is no camera of the log{did_you_mean(name, cameras)}")
    if found is None:
        there = f"the log has {', '.join(cameras)}" if cameras else "the log has none"
        raise ConfigError(f"{where}: which camera are the boxes of? {there}; name it")
    return found


def default_camera(source: BoxSource, coordinates: CoordinateFrames) -> str:
    """Camera of 2D boxes where a file doesn't name it; a coordinate frame that was meant for 3D boxes alone is none."""
    is_frame = source.camera == source.frame and coordinates.camera(source.camera) is None
    return "" if is_frame else source.camera


def _in_body(boxes: Boxes3D, name: str, coordinates: CoordinateFrames, where: str) -> Boxes3D:
    if name in ("", "body", coordinates.body):
        return boxes
    return moved(boxes, body_T(name, coordinates, where))


def _merge(boxes: Boxes3D, parts: Sequence[tuple[np.ndarray, Boxes3D]]) -> Boxes3D:
    """Put moved parts back into the order of the rows."""
    center, yaw = boxes.center_m.copy(), boxes.yaw_rad.copy()
    pitch, roll = np.zeros(len(boxes)), np.zeros(len(boxes))
    velocity = None if boxes.velocity_mps is None else boxes.velocity_mps.copy()
    for rows, part in parts:
        center[rows], yaw[rows] = part.center_m, part.yaw_rad
        pitch[rows] = 0.0 if part.pitch_rad is None else part.pitch_rad
        roll[rows] = 0.0 if part.roll_rad is None else part.roll_rad
        if velocity is not None and part.velocity_mps is not None:
            velocity[rows] = part.velocity_mps
    return replace(boxes, center_m=center, yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll, velocity_mps=velocity)
