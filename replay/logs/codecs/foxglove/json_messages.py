"""Foxglove messages in JSON, turned into Protobuf, so that one codec reads both.

https://docs.foxglove.dev/docs/sdk/schemas: fields have the names of the Protobuf schemas, times and durations are
objects of `sec` and `nsec`, bytes are base64, enumerations are numbers. JSON has no numbers that aren't finite: web
tools write `null` for them, Python's writer `NaN` and `Infinity`.
"""

import binascii
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pool, json_format, message_factory
from google.protobuf.descriptor import Descriptor
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message import Message as Proto
from google.protobuf.timestamp_pb2 import Timestamp

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Codec, Origin, Probe, TruthPart
from fbench.replay.logs.coordinate_frames import Edge

MAX_VALUES = 500_000
"""Of one message: each takes some bytes of text, and a hundred in memory. Bulk data are one text."""
_DATA = "data"  # The field with bulk data, of all schemas that have such
_SURROGATE = re.compile(rb"\\u[dD]")
_TIMES: Mapping[str, type[Timestamp | Duration]] = {
    kind.DESCRIPTOR.full_name: kind for kind in (Timestamp, Duration)
}  # fmt: skip
_REFUSALS = (json_format.ParseError, ValueError, TypeError, OverflowError, AttributeError, KeyError)
"""What the library raises for values that a field can't hold."""


def parse_json(data: memoryview) -> Any:
    """Parse a message. Raises DecodeError where it isn't JSON in UTF-8, is nested too deep, or has too many values."""
    content = bytes(data)
    if (num := sum(map(content.count, (b",", b"{", b"[")))) > MAX_VALUES:
        raise DecodeError(f"JSON of over {min(num, len(content))} values, more than {MAX_VALUES}")
    try:
        value = json.loads(content.decode("utf-8-sig"))
        if _SURROGATE.search(content):  # halves of pairs alone are no Unicode, which not all code can stand
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except RecursionError as error:
        raise DecodeError("JSON is nested too deeply") from error
    except ValueError as error:
        raise DecodeError(f"not JSON ({error})") from error


def to_protobuf(schema: str, data: memoryview) -> memoryview:
    """Encode a message of a Foxglove schema, given in JSON, as Protobuf. Raises DecodeError where it isn't one."""
    content = parse_json(data)
    if not isinstance(content, dict):
        raise DecodeError(f"not a {schema} (a JSON {type(content).__name__}, expected an object)")
    descriptor = descriptor_pool.Default().FindMessageTypeByName(schema)
    field = descriptor.fields_by_name.get(_DATA)
    has_bulk = field is not None and field.type == field.TYPE_BYTES
    bulk = _decode_base64(content.pop(_DATA, None)) if has_bulk else b""
    proto: Proto = message_factory.GetMessageClass(descriptor)()
    try:
        json_format.ParseDict(_convert(content, descriptor), proto, ignore_unknown_fields=True)
    except _REFUSALS as error:
        raise DecodeError(f"not a {schema} ({error})") from error
    if has_bulk:
        setattr(proto, _DATA, bulk)
    return memoryview(proto.SerializeToString(deterministic=True))


def _decode_base64(text: object) -> bytes:
    if text is None:
        return b""
    if not isinstance(text, str):
        raise DecodeError(f"its data are a JSON {type(text).__name__}, expected a text in base64")
    try:
        return binascii.a2b_base64(text, strict_mode=True)
    except ValueError as error:
        raise DecodeError(f"its data aren't base64 ({error})") from error


def _convert(value: Any, descriptor: Descriptor) -> Any:
    """Return a message with times, and numbers of lists, as Protobuf's own JSON has them; what isn't as expected
    stays.
    """
    if not isinstance(value, dict):
        return value
    found = dict(value)
    for key, part in value.items():
        field = descriptor.fields_by_name.get(key)
        inner = None if field is None else field.message_type
        if field is None:
            continue
        if inner is None:
            is_list = isinstance(part, list) and field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT)
            found[key] = [_spell(number) for number in part] if is_list else part
        elif inner.full_name in _TIMES:
            found[key] = _format_time(_TIMES[inner.full_name], part)
        elif isinstance(part, list):
            found[key] = [_convert(item, inner) for item in part]
        else:
            found[key] = _convert(part, inner)
    return found


def _spell(number: Any) -> Any:
    """Return a number of a list, of which `null` is one that isn't finite, as Protobuf's own JSON has it."""
    if number is None:
        return "NaN"
    if not isinstance(number, float) or math.isfinite(number):
        return number
    return "NaN" if math.isnan(number) else "Infinity" if number > 0 else "-Infinity"


def _format_time(kind: type[Timestamp | Duration], time: Any) -> Any:
    if not isinstance(time, dict):
        return time  # a text, as Protobuf's own JSON has it, or something that it refuses
    parts = [time.get("sec", 0), time.get("nsec", time.get("nanosec", 0))]
    if not all(isinstance(part, int) and not isinstance(part, bool) for part in parts):
        raise ValueError(f"a time of {parts[0]!r} s {parts[1]!r} ns isn't of whole numbers")
    return kind(seconds=parts[0], nanos=parts[1]).ToJsonString()


def json_codec(schema: str, codec: Codec) -> Codec:
    """Return the codec of a schema in JSON, made from that of the same schema in Protobuf."""
    return _JsonCodec(schema, codec)


@dataclass(frozen=True)
class _JsonCodec:
    """Decodes the messages of one schema in JSON; see `Codec`."""

    schema: str
    codec: Codec

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.codec.kinds

    def probe(self, data: memoryview) -> Probe:
        return self.codec.probe(to_protobuf(self.schema, data))

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        return self.codec.message(kind, to_protobuf(self.schema, data), origin)

    def assembler(self) -> None:
        """Each message is a measurement."""

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        return self.codec.transforms(to_protobuf(self.schema, data))

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        return self.codec.stamps(to_protobuf(self.schema, data))

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        return self.codec.calibration(to_protobuf(self.schema, data))

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        return self.codec.truth(to_protobuf(self.schema, data), origin)
