"""Which topic holds the intrinsics of each camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, takewhile

from fbench.replay.data import CameraModel
from fbench.replay.errors import DataError, DecodeError
from fbench.replay.init.draft import Line
from fbench.replay.init.guess_sensors import Candidate
from fbench.replay.logs.container import Container
from fbench.replay.logs.roles import Role

_TRIES = 3
_TRANSPORTS = ("compressed", "theora", "ffmpeg", "raw")
"""Below the topic of an image."""


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
