"""Guesses of the rig: body frame, poses and intrinsics."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, takewhile

from fbench.replay.contracts.errors import DataError, DecodeError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.logs.container import Container
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS, TransformTree
from fbench.replay.logs.partial_rig import partial_rig
from fbench.replay.logs.poses import TfSource
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.rig import first_state
from fbench.replay.logs.roles import Role
from fbench.replay.logs.setup import SensorSetup, Setup
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import Heard, Line, Look


@dataclass(frozen=True, eq=False)
class Body:
    """Where sensors are."""

    line: Line | None  # `None`: the log says so itself
    rig: Rig  # Of the sensors that have a place, and the cameras among them that are calibrated
    problems: Mapping[str, str]  # What the others lack, by name of the sensor


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


@dataclass(frozen=True, eq=False)
class PoseChoice:
    """The topic that is taken, and what is said about it and the others."""

    chosen: Heard | None
    lines: tuple[Line, ...]


def guess_pose(look: Look, body: Body) -> PoseChoice:
    """Take the topic with the highest rate of those that give the body's own pose, else of all."""
    found = [
        h for h in look.heard if h.role.kind in ("pose", "odometry") and h.num_messages and any(s.pose for s in h.seen)
    ]
    if not found:
        return PoseChoice(None, _from_transforms(look))
    name = "" if body.line is None else str(body.line.value)
    order = sorted(found, key=lambda h: (h.role.frame_id not in ("", name), -h.num_messages, h.topic))
    best, others = order[0], order[1:]
    if best.role.is_own and not others:
        return PoseChoice(best, ())
    of = f", of '{best.role.frame_id}'" if best.role.frame_id else ""
    is_certain = best.role.kind == "pose" or best.role.frame_id == name
    more = ", the most frequent one" if others else ""
    line = Line("pose", best.topic, f"{best.schema}, {best.num_messages} messages{of}{more}", is_guess=not is_certain)
    rest = tuple(Line("pose", h.topic, f"{h.schema}, {h.num_messages} messages", is_active=False) for h in others)
    return PoseChoice(best, (line, *rest))


def _from_transforms(look: Look) -> tuple[Line, ...]:
    """A topic with transforms that move, where they say where the body is."""
    topics = sorted({r.topic for r in look.roles.values() if r.kind == "transform" and not r.is_static})
    for topic in topics:
        try:
            world = TfSource(look.container, look.roles, topic, lambda: first_state(look.container, look.roles)).world
        except LogError:
            continue
        return (Line("pose", topic, f"its transforms say where the body is in '{world}'"),)
    return ()


_TRIES = 3
_TRANSPORTS = ("compressed", "theora", "ffmpeg", "raw")  # Below the topic of an image


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """What a topic with calibration says."""

    topic: str
    frame: str
    model: CameraModel


def intrinsics_of(container: Container, roles: Mapping[int, Role]) -> tuple[Intrinsics, ...]:
    """Read the first calibration of each topic that other programs wrote."""
    found: dict[str, Intrinsics] = {}
    for id_, role in sorted(roles.items()):
        if role.kind == "calibration" and not role.is_own and role.topic not in found:
            first = _first(container, id_, role)
            if first is not None:
                found[role.topic] = first
    return tuple(intrinsics for _, intrinsics in sorted(found.items()))


def _first(container: Container, channel: int, role: Role) -> Intrinsics | None:
    for entry in islice(container.entries(frozenset([channel])), _TRIES):
        try:
            if role.codec is not None and isinstance(entry.data, memoryview):
                return Intrinsics(role.topic, *role.codec.calibration(entry.data))
        except (DecodeError, DataError):
            continue
    return None


def calibration_line(camera: Candidate, known: Sequence[Intrinsics]) -> Line | None:
    """Name the topic with the calibration of a camera; `None` where the log has none for it, or says so itself."""
    if camera.is_own:
        return None
    found, why, is_guess = _choose(camera, known)
    if found is None:
        return None
    wrong = _mismatch(camera, found)
    return Line("calibration", found.topic, f"{why}; {wrong}" if wrong else why, is_guess=is_guess or bool(wrong))


def _choose(camera: Candidate, known: Sequence[Intrinsics]) -> tuple[Intrinsics | None, str, bool]:
    topic, frame = camera.heard.topic, camera.heard.role.frame_id
    for folder in _folders(topic):
        beside = [i for i in known if i.topic.rpartition("/")[0] == folder]
        if beside:
            best = min(beside, key=lambda i: (not i.topic.endswith("/camera_info"), i.topic))
            return best, "in the same namespace", len(beside) > 1
    same = [i for i in known if frame and i.frame == frame]
    if same:
        best = min(same, key=lambda i: (_distance(i.topic, topic), i.topic))
        return best, f"of the same coordinate frame, '{frame}'", len(same) > 1
    return None, "", False


def _distance(a: str, b: str) -> int:
    """Parts of two topics that they don't have in common from the start."""
    parts_a, parts_b = a.split("/"), b.split("/")
    num = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(parts_a, parts_b, strict=False)))
    return len(parts_a) + len(parts_b) - 2 * num


def _folders(topic: str) -> list[str]:
    """The namespace of a topic, and that around it: `image_raw/compressed` lies one deeper than its `camera_info`."""
    folder, _, last = topic.rpartition("/")
    return [folder, folder.rpartition("/")[0]] if last in _TRANSPORTS else [folder]


def _mismatch(camera: Candidate, found: Intrinsics) -> str:
    size, calibrated = camera.heard.size_wh, found.model.size_wh
    if size is not None and size != calibrated:
        return f"but it is for {calibrated[0]}x{calibrated[1]} px, images have {size[0]}x{size[1]}"
    if "rect" in camera.heard.topic.lower() and found.model.distortion.any():
        return "but images are rectified, and its K and distortion are for images that aren't"
    return ""
