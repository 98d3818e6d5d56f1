"""Items that a conversion moves from log to log, encoded for the level of the container."""

from typing import NamedTuple

from google.protobuf.message import Message as Proto

from fbench.replay.data.messages import Message
from fbench.replay.data.rig import Rig
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.codecs.foxglove.proto import descriptor_set
from fbench.replay.logs.codecs.foxglove.topics import Record, message_records, part_record, rig_records
from fbench.replay.logs.container import Channel, Entry, Schema


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


class Encoded(NamedTuple):
    """One message as a container of bytes holds it."""

    channel: Channel
    publish_ns: int
    sequence: int
    data: bytes


class Encoder:
    """Encodes messages; keeps the schemas that it met."""

    def __init__(self) -> None:
        self._schemas: dict[str, Schema] = {}

    def message(self, topic: str, content: Message | TruthPart) -> Encoded:
        """Encode a measurement, pose or part of truth, under its own topic.

        Raises:
            ValueError: where Protobuf can't hold a value.
        """
        if isinstance(content, TruthPart):
            truth = content.truth
            return self._encoded(part_record(content), truth.stamp_ns, truth.frame_number)
        record = next(message_records(content))
        return self._encoded(record._replace(topic=topic), content.stamp_ns, content.frame_number)

    def result(self, part: TruthPart) -> Encoded:
        """Encode the boxes that another system found.

        Raises:
            ValueError: where Protobuf can't hold a value.
        """
        return self._encoded(part_record(part, "detections"), part.truth.stamp_ns, part.truth.frame_number)

    def rig(self, stamp_ns: int, rig: Rig) -> list[Encoded]:
        """Encode a rig: a transform a sensor and a calibration a camera.

        Raises:
            ValueError: where Protobuf can't hold a value.
        """
        return [self._encoded(record, stamp_ns, None) for record in rig_records(stamp_ns, rig)]

    def _encoded(self, record: Record, stamp_ns: int, frame_number: int | None) -> Encoded:
        channel = Channel(record.topic, "protobuf", self._schema(record.proto), record.metadata)
        return Encoded(channel, stamp_ns, frame_number or 0, record.proto.SerializeToString(deterministic=True))

    def _schema(self, proto: Proto) -> Schema:
        name = proto.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = Schema(name, "protobuf", descriptor_set(type(proto)))
        return self._schemas[name]
