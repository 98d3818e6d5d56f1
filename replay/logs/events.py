"""Decoding of single entries of a log into messages and truth, in body coordinates and with the user's names."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError, DecodeError, LogError, PointsError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.classes import ClassMap
from fbench.replay.data.messages import Image, Message, Pose, Truth
from fbench.replay.logs.arrange import apply_setup
from fbench.replay.logs.assembly import Assembly
from fbench.replay.logs.calibration import LogCalibration
from fbench.replay.logs.codecs.codec import Codec, NothingError, Origin, TruthPart
from fbench.replay.logs.codecs.video.stream import VideoStreams
from fbench.replay.logs.container import Entry
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS, invalid
from fbench.replay.logs.poses import TfPoses, of_body
from fbench.replay.logs.roles import Role
from fbench.replay.logs.truth import in_body

T = TypeVar("T", bound=Message | Truth)

_MAX_STAMP_NS = 2**63 - 1


class EventDecoder:
    """Decodes the entries of one log; what can't be decoded is counted as a fault, once: by the container, or in
    `faults` where they are given.
    """

    def __init__(self, calibration: LogCalibration, faults: FaultLog | None = None) -> None:
        self._calibration = calibration
        self._once = calibration.container.once if faults is None else faults.once
        self._roles, self._setup = calibration.roles, calibration.setup

    def message(
        self, entry: Entry, moving: TfPoses | None, assembly: Assembly, videos: VideoStreams | None = None
    ) -> Message | None:
        """Decode a measurement or pose; `moving` composes poses from transforms, `assembly` measurements from parts,
        `videos` tells how pictures follow each other. `None` where it can't be read, isn't whole yet, or is only a part
        of the next message.
        """
        message = self._read(entry, moving, assembly)
        if videos is None or not isinstance(message, Image):
            return message
        placed = videos.take(entry.topic, message)
        is_video = placed is not None and placed.video is not None and placed.video.source is not None
        if placed is not None and is_video and not videos.is_numbered(entry.topic):
            self._once("DEC006", (entry.topic,), f"{entry.topic}: {placed.encoding}")
        return placed

    def _read(self, entry: Entry, moving: TfPoses | None, assembly: Assembly) -> Message | None:
        role = self._roles[entry.channel]
        try:
            _check(entry)
            if not isinstance(entry.data, memoryview):
                stored = entry.data.read()
                if isinstance(stored, TruthPart):
                    raise DecodeError("truth in the place of a measurement")
                return apply_setup(replace(stored, sensor=role.sensor), self._setup)
            if moving is not None and entry.channel in self._calibration.tf.channels:
                codec = _codec(role)
                return moving.take(codec.transforms(entry.data), codec.stamps(entry.data), entry.log_ns)
            origin = make_origin(role, entry)
            message = assembly.message(entry.channel, _codec(role), role.kind, entry.data, origin)
            if message is None:
                return None
            if isinstance(message, Pose) and not role.is_own:
                message = self._of_body(message, role.frame_id)
            return apply_setup(self._stamp(entry, message), self._setup)
        except NothingError:
            return None
        except (DecodeError, DataError) as error:
            self._count(entry, error)
            return None

    def truth_part(self, entry: Entry) -> TruthPart | None:
        """Decode a message of truth, into body coordinates; `None` where it can't be read."""
        role = self._roles[entry.channel]
        try:
            _check(entry)
            if isinstance(entry.data, memoryview):
                part = _codec(role).truth(entry.data, make_origin(role, entry))
                part = replace(part, truth=self._stamp(entry, part.truth))
            elif isinstance(stored := entry.data.read(), TruthPart):
                part = stored
            else:
                raise DecodeError("a measurement in the place of truth")
            if part.frame_id:
                cameras = {r.frame_id: r.sensor for _, r in sorted(self._roles.items()) if r.kind == "camera"}
                tree, body = self._calibration.tree()
                if {part.frame_id, *part.frame_ids} - {"", body, *WORLDS}:  # which may have moved on the body since
                    tree, body = self._calibration.tree((part.truth.stamp_ns, entry.log_ns))
                part = in_body(part, tree, body, cameras, self._calibration.poses_in)
            return replace(part, truth=self.classify(part.truth, "" if role.is_own else entry.topic))
        except NothingError:
            return None
        except (DecodeError, DataError) as error:
            self._count(entry, error)
            return None

    def try_rig(self, entry: Entry, kind: str) -> None:
        """Count what can't be decoded of a transform or calibration that isn't followed."""
        try:
            if kind in ("transform", "calibration") and isinstance(entry.data, memoryview):
                codec = _codec(self._roles[entry.channel])
                codec.transforms(entry.data) if kind == "transform" else codec.calibration(entry.data)
        except DecodeError as error:
            self._count(entry, error)

    def classify(self, truth: Truth, where: str) -> Truth:
        """Return truth with the labels that the setup gives; a name that means nothing is counted once. Importers of
        fbench know theirs: `where` is empty then.
        """

        def count(name: str) -> None:
            if where:
                self._once("GT007", (where, name), f"{where}: '{name}'")

        return ClassMap(self._setup.classes).label_truth(truth, count)

    def _of_body(self, pose: Pose, child: str) -> Pose:
        """Where the body is, from the pose of a coordinate frame that is fixed to it."""
        if (why := invalid(pose.translation_m, pose.rotation_xyzw)) is not None:
            raise DecodeError(f"pose {why}")
        try:
            body_T_child = self._calibration.coordinate_frames.body_T(child)
        except LogError:  # messages can be read even where the rig can't
            return pose
        if body_T_child is None and child not in BODIES:
            raise DecodeError(f"pose of '{child}', which no fixed transform links to the body")
        return pose if body_T_child is None or np.array_equal(body_T_child, np.eye(4)) else of_body(pose, body_T_child)

    def _stamp(self, entry: Entry, item: T) -> T:
        """Give what another program left without a stamp the time of its recording; counted once a topic."""
        if item.stamp_ns or not entry.log_ns or self._roles[entry.channel].is_own:
            return item
        self._once("TIM011", (entry.topic,), f"{entry.topic} at {entry.log_ns}")
        return replace(item, stamp_ns=entry.log_ns)

    def _count(self, entry: Entry, error: Exception) -> None:
        code = "DEC003" if isinstance(error, PointsError) else "DEC001"
        where = f"{entry.topic} at {entry.publish_ns}: {error}"
        self._once(code, (entry.part, entry.block, entry.offset), where)


def _codec(role: Role) -> Codec:
    if role.codec is None:
        raise DecodeError(f"topic '{role.topic}' can't be decoded")
    return role.codec


def make_origin(role: Role, entry: Entry) -> Origin:
    """Return what the container says about a message."""
    number = entry.sequence if role.numbered else None
    return Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)


def _check(entry: Entry) -> None:
    if max(entry.log_ns, entry.publish_ns) > _MAX_STAMP_NS:
        raise DecodeError("stamp doesn't fit an int64")
