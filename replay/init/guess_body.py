"""Which coordinate frame is the body's, and which sensors have a place on it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fbench.replay.data import Rig
from fbench.replay.errors import DecodeError
from fbench.replay.faults import FaultLog
from fbench.replay.init.draft import Line
from fbench.replay.init.guess_sensors import Candidate
from fbench.replay.logs.container import Container
from fbench.replay.logs.coordinates import WORLDS
from fbench.replay.logs.partial_rig import partial_rig
from fbench.replay.logs.read_rig import first_state
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.roles import Role
from fbench.replay.logs.setup import SensorSetup, Setup
from fbench.replay.logs.tree import BODIES, TransformTree


@dataclass(frozen=True, eq=False)
class Body:
    """Where sensors are."""

    line: Line | None
    """`None`: the log says so itself."""
    rig: Rig
    """Of the sensors that have a place, and the cameras among them that are calibrated."""
    problems: Mapping[str, str]
    """What the others lack, by name of the sensor."""


def guess_body(
    container: Container, roles: Mapping[int, Role], sensors: Sequence[Candidate], calibrations: Mapping[str, str]
) -> Body:
    """Find the body and the rig; `calibrations` are the topics with the intrinsics of cameras, by sensor."""
    line = None if all(s.is_own for s in sensors) else _line(_tree(container, roles, sensors), sensors)
    said = {s.name: SensorSetup(s.heard.topic, s.kind, calibration=calibrations.get(s.name, "")) for s in sensors}
    setup = Setup(sensors=said, body="" if line is None else str(line.value), source="fbench init")
    known = partial_rig(LogReader(container, (), setup, FaultLog()))
    return Body(line, known.rig, known.problems)


def _tree(container: Container, roles: Mapping[int, Role], sensors: Sequence[Candidate]) -> TransformTree:
    topics = {s.heard.topic for s in sensors}
    kept = {id_: role for id_, role in roles.items() if role.kind == "transform" or role.topic in topics}
    return first_state(container, kept).tree


def _line(tree: TransformTree, sensors: Sequence[Candidate]) -> Line:
    paths = [_path(tree, s.heard.role.frame_id) for s in sensors]
    num = Counter(name for path in paths for name in path)
    named = next((name for name in BODIES if num[name]), None)
    if named is not None:
        return Line("frame", named, f"called so; {num[named]} of {len(paths)} sensors hang on it")
    places = [(num[name], path.index(name), name) for path in paths for name in path if name.strip("/") not in WORLDS]
    if not any(len(path) > 1 for path in paths):
        first = next((s for s in sensors if s.kind == "lidar"), sensors[0])
        what = f"the log has no transforms, so that of sensor '{first.name}'"
        what += "; the others need a calibration file" if len(sensors) > 1 else ""
        return Line("frame", first.heard.role.frame_id, what, is_guess=True)
    share, _, root = max(places, default=(0, 0, ""))
    return Line("frame", root, f"root of the tree, {share} of {len(paths)} sensors hang on it", is_guess=True)


def _path(tree: TransformTree, frame: str) -> list[str]:
    try:
        return tree.path(frame)
    except DecodeError:
        return [frame]
