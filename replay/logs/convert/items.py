"""What a conversion moves from log to log."""

from typing import NamedTuple

from fbench.replay.data import Message, Rig
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.truth_part import TruthPart


class Copied(NamedTuple):
    """A message as the source has it, byte for byte."""

    channel: Channel
    entry: Entry


class Decoded(NamedTuple):
    """A message in fbench's own types."""

    topic: str
    log_ns: int
    content: Message | TruthPart


class RigAt(NamedTuple):
    """From `log_ns` on this rig holds."""

    log_ns: int
    rig: Rig
    stamp_ns: int | None = None
    """Of the messages that told it; `None`: no messages did."""


Item = Copied | Decoded | RigAt


def log_ns_of(item: Item) -> int:
    """Return the log time of an item."""
    return item.entry.log_ns if isinstance(item, Copied) else item.log_ns
