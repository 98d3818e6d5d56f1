"""Guesses of the rig: body frame, poses and intrinsics."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, takewhile

from fbench.replay.contracts.errors import DataError, DecodeError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.data.scores import format_count
from fbench.replay.logs.container import Container
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS
from fbench.replay.logs.partial_rig import partial_rig
from fbench.replay.logs.poses import TfSource
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.rig import first_state
from fbench.replay.logs.roles import Role
from fbench.replay.logs.setup import SensorSetup, Setup
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import Inspection, Line, SampledTopic


@dataclass(frozen=True, eq=False)
class Body:
    """Where sensors are."""

    line: Line | None  # `None`: the log says so itself
    rig: Rig  # Of the sensors that have a place, and the cameras among them that are calibrated
    problems: Mapping[str, str]  # What the others lack, by name of the sensor
    frames: Mapping[str, str]  # Coordinate frames of sensors whose messages name none

    cameras: frozenset[str]  # Names of all cameras

    @property
    def left_out(self) -> Mapping[str, str]:
        """Sensors that can't be used, and why. Where no camera has its place and its calibration, the images of all can
        be used alone.
        """
        if any(name in self.rig.mounts for name in self.cameras):
            return self.problems
        return {name: why for name, why in self.problems.items() if name not in self.cameras}


def guess_body(log: Inspection, sensors: Sequence[Candidate], calibrations: Mapping[str, str]) -> Body:
    """Find the body and the rig; `calibrations` are the topics with the intrinsics of cameras, by sensor."""
    container = log.container
    line = None if all(s.is_own for s in sensors) else _guess_frame(container, log.roles, sensors)
    body = str(line.value) if line is not None and line.is_active else ""
    # One whose messages name no coordinate frame has that of the body, which then is called like the sensor.
    frames = {s.name: body for s in sensors if s.name == body and not s.sampled.role.frame_id}
    said = {
        s.name: SensorSetup(s.sampled.topic, s.kind, frames.get(s.name, ""), calibrations.get(s.name, ""))
        for s in sensors
    }
    setup = Setup(sensors=said, body=body, source="fbench init", decoders=tuple(log.decoders))
    known = partial_rig(LogReader(container, (), setup, FaultLog()))
    cameras = frozenset(s.name for s in sensors if s.kind == "camera")
    return Body(line, known.rig, known.problems, frames, cameras)


def _guess_frame(container: Container, roles: Mapping[int, Role], sensors: Sequence[Candidate]) -> Line:
    """The coordinate frame of the body: one that is called so, else the root of most sensors."""
    topics = {s.sampled.topic for s in sensors}
    kept = {id_: role for id_, role in roles.items() if role.kind == "transform" or role.topic in topics}
    tree, paths = first_state(container, kept).tree, list[list[str]]()
    for s in sensors:
        frame = s.sampled.role.frame_id
        try:
            paths.append(tree.path(frame))
        except DecodeError:
            paths.append([frame])
    num = Counter(name for path in paths for name in path)
    named = next((name for name in BODIES if num[name]), None)
    if named is not None:
        return Line("frame", named, f"by its name; {num[named]} of {len(paths)} sensors are linked to it")
    if not any(len(path) > 1 for path in paths):
        measured = sorted((s for s in sensors if s.kind != "camera"), key=lambda s: s.kind)  # LiDARs before radars
        if not measured:
            return Line("frame", "base_link", "the log has no transforms, so images are used alone", is_active=False)
        first = measured[0]
        what = f"the log has no transforms: sensor '{first.name}' is assumed at the body's origin, x forward, z up"
        what += "; the others need a calibration file" if len(measured) > 1 else ""
        return Line("frame", first.sampled.role.frame_id or first.name, what, is_guess=True)
    places = [(num[name], path.index(name), name) for path in paths for name in path if name.strip("/") not in WORLDS]
    share, _, root = max(places, default=(0, 0, ""))
    return Line("frame", root, f"root of the tree; {share} of {len(paths)} sensors are linked to it", is_guess=True)


def guess_pose(log: Inspection, body: Body) -> tuple[SampledTopic | None, tuple[Line, ...]]:
    """The topic with the highest rate of those with the body's own pose, else of all; and lines about it and others."""
    found = [t for t in log.topics if t.role.kind in ("pose", "odometry") and any(s.pose for s in t.samples)]
    found = [t for t in found if t.num_messages]
    if not found:
        return None, _find_moving_transforms(log)
    name = "" if body.line is None else str(body.line.value)
    best, *others = sorted(found, key=lambda t: (t.role.frame_id not in ("", name), -t.num_messages, t.topic))
    if best.role.is_own and not others:
        return best, ()
    of = f", of '{best.role.frame_id}'" if best.role.frame_id else ""
    is_certain = best.role.kind == "pose" or best.role.frame_id == name
    more = ", the most frequent one" if others else ""
    line = Line(
        "pose",
        best.topic,
        f"{best.schema}, {format_count(best.num_messages, 'message')}{of}{more}",
        is_guess=not is_certain,
    )
    rest = (
        Line("pose", t.topic, f"{t.schema}, {format_count(t.num_messages, 'message')}", is_active=False) for t in others
    )
    return best, (line, *rest)


def _find_moving_transforms(log: Inspection) -> tuple[Line, ...]:
    """A topic with transforms that move, where they say where the body is."""
    for topic in sorted({r.topic for r in log.roles.values() if r.kind == "transform" and not r.is_static}):
        with suppress(LogError):
            world = TfSource(log.container, log.roles, topic, lambda: first_state(log.container, log.roles)).world
            return (Line("pose", topic, f"its transforms say where the body is in '{world}'"),)
    return ()


_TRIES = 3
_TRANSPORTS = ("compressed", "theora", "ffmpeg", "raw")  # Below the topic of an image


def read_intrinsics(container: Container, roles: Mapping[int, Role]) -> dict[str, tuple[str, CameraModel]]:
    """Read the first calibration of each topic that other programs wrote: coordinate frame and intrinsics by topic."""
    found: dict[str, tuple[str, CameraModel]] = {}
    for id_, role in sorted(roles.items()):
        if role.kind == "calibration" and not role.is_own and role.codec is not None and role.topic not in found:
            for entry in islice(container.entries(frozenset([id_])), _TRIES):
                with suppress(DecodeError, DataError):
                    if isinstance(entry.data, memoryview):
                        found[role.topic] = role.codec.calibration(entry.data)
                        break
    return found


def calibration_line(camera: Candidate, known: Mapping[str, tuple[str, CameraModel]]) -> Line | None:
    """Name the topic with the calibration of a camera; `None` where the log has none for it, or says so itself."""
    sampled = camera.sampled
    if camera.is_own:
        return None
    folder, _, last = sampled.topic.rpartition("/")
    # `image_raw/compressed` lies one deeper than its `camera_info`.
    for namespace in (folder, folder.rpartition("/")[0]) if last in _TRANSPORTS else (folder,):
        near = [topic for topic in known if topic.rpartition("/")[0] == namespace]
        if near:
            best = min(near, key=lambda topic: (not topic.endswith("/camera_info"), topic))
            why, is_guess = "in the same namespace", len(near) > 1
            break
    else:
        frame = sampled.role.frame_id
        same = [topic for topic, (its_frame, _) in known.items() if frame and its_frame == frame]
        if not same:
            return None
        best = min(same, key=lambda topic: (_distance(topic, sampled.topic), topic))
        why, is_guess = f"of the same coordinate frame, '{frame}'", len(same) > 1
    size, (_, model), wrong = sampled.size_wh, known[best], ""
    if size is not None and size != model.size_wh:
        wrong = f"; but it is for {model.size_wh[0]}x{model.size_wh[1]} px, images have {size[0]}x{size[1]}"
    elif "rect" in sampled.topic.lower() and model.distortion.any():
        wrong = "; but images are rectified, and its K and distortion are for images that aren't"
    return Line("calibration", best, why + wrong, is_guess=is_guess or bool(wrong))


def _distance(a: str, b: str) -> int:
    """Parts of two topics that they don't have in common from the start."""
    parts = a.split("/"), b.split("/")
    num = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(*parts, strict=False)))
    return len(parts[0]) + len(parts[1]) - 2 * num
