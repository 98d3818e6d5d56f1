"""Decoding what fbench wrote, but only where encoding it again gives the same bytes."""

from fbench.replay.data import Message
from fbench.replay.errors import DataError, DecodeError
from fbench.replay.logs.codec import MESSAGES, Origin
from fbench.replay.logs.container import Channel, Container, Entry
from fbench.replay.logs.convert.encode import Encoded, Encoder
from fbench.replay.logs.roles import STORED, Role
from fbench.replay.logs.truth_part import TruthPart


class InexactError(Exception):
    """A message that would change on the way: its channel must be copied as it is."""

    def __init__(self, channel: int) -> None:
        super().__init__(channel)
        self.channel = channel


def candidates(container: Container, roles: dict[int, Role]) -> frozenset[int]:
    """Channels that fbench seems to have written."""
    return frozenset(
        id_
        for id_, role in roles.items()
        if role.is_own and role.kind in (*MESSAGES, "truth") and container.channels[id_].encoding != STORED
    )


def exactly_decoded(role: Role, channel: Channel, entry: Entry, encoder: Encoder) -> Message | TruthPart:
    """Decode a message of a channel that fbench wrote.

    Raises:
        InexactError: where it isn't what fbench would write today.
    """
    try:
        content = _decoded(role, entry)
        encoded = encoder.message(channel.topic, content)
    except (DecodeError, DataError, ValueError) as error:
        raise InexactError(entry.channel) from error
    if not is_same(encoded, channel, entry):
        raise InexactError(entry.channel)
    return content


def is_same(encoded: Encoded, channel: Channel, entry: Entry) -> bool:
    """Tell whether a message of a container is what was encoded, in every byte."""
    head = encoded.channel == channel and (encoded.publish_ns, encoded.sequence) == (entry.publish_ns, entry.sequence)
    return head and isinstance(entry.data, memoryview) and bytes(entry.data) == encoded.data


def _decoded(role: Role, entry: Entry) -> Message | TruthPart:
    if role.codec is None or not isinstance(entry.data, memoryview):
        raise DecodeError("not a message of bytes")
    number = entry.sequence if role.numbered else None
    origin = Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)
    if role.kind == "truth":
        return role.codec.truth(entry.data, origin)
    return role.codec.message(role.kind, entry.data, origin)
