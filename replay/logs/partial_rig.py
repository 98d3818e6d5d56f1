"""The known part of an incomplete rig, sensor by sensor."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import KINDS, CameraModel, Kind, Mount, Rig
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.rig import first_state
from fbench.replay.logs.roles import sensor_roles


@dataclass(frozen=True, eq=False)
class PartialRig:
    """The sensors of a log, with their calibration where it is there."""

    kinds: Mapping[str, Kind]  # All sensors, by name
    rig: Rig  # Mounts and cameras that are known
    problems: Mapping[str, str]  # What is missing of the others, by sensor


def partial_rig(reader: LogReader) -> PartialRig:
    """Return the rig of a log, and for each sensor that it lacks the reason; never fails for a missing calibration."""
    heard = {r.sensor: KINDS[r.kind] for r in sensor_roles(reader.roles)}
    try:
        rig = reader.rig
    except LogError as error:
        return _search_parts(reader, heard, _describe(reader, error))
    uncalibrated = rig.bare | (frozenset(rig.sensors("camera")) - frozenset(rig.cameras))
    if uncalibrated and not reader.container.rigs:
        return _search_parts(reader, heard, "")
    kinds = dict(sorted({**rig.kinds, **heard}.items()))
    problems: dict[str, str] = {}
    for name, kind in kinds.items():
        if name not in rig.mounts:
            problems[name] = f"sensor '{name}' has no transform to the body"
        elif kind == "camera" and name not in rig.cameras:
            problems[name] = f"camera '{name}' has no calibration"
    return PartialRig(kinds, Rig(rig.mounts, rig.cameras), problems)


def _search_parts(reader: LogReader, heard: Mapping[str, Kind], reason: str) -> PartialRig:
    header = reader.container.header
    written = {} if header is None or reader.setup.sensors else header.kinds
    silent = {name: kind for name, kind in written.items() if name not in reader.left_out}
    kinds = dict(sorted({**silent, **heard}.items()))
    state = first_state(reader.container, reader.roles, reader.left_out, reader.setup)
    mounts: dict[str, Mount] = {}
    cameras: dict[str, CameraModel] = {}
    problems: dict[str, str] = {}
    for name in kinds:
        try:
            alone = replace(state, left_out=reader.left_out | (frozenset(kinds) - {name})).rig(is_strict=True)
        except LogError as error:
            problems[name] = _describe(reader, error)
            frames = [r.frame_id for _, r in sorted(state.roles.items()) if r.sensor == name and r.kind == "camera"]
            camera = next((state.cameras[frame] for frame in frames if frame in state.cameras), None)
            camera = state.patch.cameras.get(name, camera)
            cameras |= {} if camera is None else {name: camera}
        else:
            mounts |= {name: alone.mounts[name]}
            cameras |= {name: alone.cameras[name]} if name in alone.cameras else {}
    if reason and not problems:  # each reaches a body, but not the same one
        return PartialRig(kinds, Rig({}, cameras), dict.fromkeys(kinds, reason))
    return PartialRig(kinds, Rig(mounts, cameras), problems)


def _describe(reader: LogReader, error: LogError) -> str:
    return str(error).removeprefix(f"{reader.container.path}: ")
