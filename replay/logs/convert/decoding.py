"""The items of a log as fbench understands them, whatever wrote it."""

from collections import Counter
from collections.abc import Iterator

from fbench.replay.data import RigChange
from fbench.replay.logs.convert.cut import Window
from fbench.replay.logs.convert.items import Decoded, Item, RigAt
from fbench.replay.logs.foxglove.topics import BOXES2D, BOXES3D
from fbench.replay.logs.header import LogHeader, header_of
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.roles import Role
from fbench.replay.logs.truth_part import TruthPart


class Decoding:
    """Measurements, poses, truth and rigs in canonical order; what else there is gets counted in `left_out`.

    Raises:
        LogError: naming the sensor that has no transform, or the camera that isn't calibrated.
    """

    def __init__(self, reader: LogReader, window: Window) -> None:
        self._reader, self._window = reader, window
        self._rig = reader.rig
        self.about: LogHeader = header_of(reader.info, reader.rig)
        self.left_out: Counter[str] = Counter()

    def items(self) -> Iterator[Item]:
        """Read the log once; damaged messages are counted as faults."""
        waiting: RigAt | None = RigAt(0, self._rig)
        for entry, content in self._reader.everything():
            if self._window.is_behind(entry.log_ns):
                break
            if isinstance(content, RigChange):
                early = self._window.is_before(content.log_ns) or waiting is not None
                waiting = RigAt(0, content.rig) if early else RigAt(content.log_ns, content.rig, content.log_ns)
            if self._window.is_before(entry.log_ns) or isinstance(content, RigChange):
                continue
            role = self._reader.roles.get(entry.channel)
            if content is None or role is None or role.kind == "detections" or _in_world(content):
                if _is_lost(role) or _in_world(content):
                    self.left_out[entry.topic] += 1
                continue
            if waiting is not None:
                yield waiting
                waiting = None
            yield Decoded(_topic(entry.topic, content), entry.log_ns, content)
        if waiting is not None:
            self._window.require_all()
            yield waiting


def _topic(topic: str, content: object) -> str:
    """Truth comes under the names that fbench gives it, measurements keep theirs."""
    if isinstance(content, TruthPart):
        return BOXES2D if content.is_2d else BOXES3D
    return topic


def _in_world(content: object) -> bool:
    """Tell whether content is truth that only a pose could move to the body."""
    return isinstance(content, TruthPart) and content.truth.in_world


def _is_lost(role: Role | None) -> bool:
    """Tell whether a message without content is left out on purpose: neither damaged nor part of the rig."""
    if role is None or role.kind == "detections":
        return True
    return role.kind == "transform" and not role.is_static
