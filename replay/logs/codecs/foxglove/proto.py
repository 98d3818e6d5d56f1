"""Protobuf basics: schemas with their dependencies, time stamps, parsing, large fields without copies.

https://protobuf.dev/programming-guides/encoding: a message is a sequence of tags (field number and wire type) and
values. Parsing clouds and images whole would copy them once more.
"""

from typing import Any, TypeVar

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError as ProtobufError
from google.protobuf.message import Message as Proto
from google.protobuf.timestamp_pb2 import Timestamp

from fbench.replay.contracts.errors import DecodeError

_NS_PER_S = 1_000_000_000
MAX_STAMP_NS = 2**63 - 1

M = TypeVar("M", bound=Proto)


def descriptor_set(message: type[Proto]) -> bytes:
    """Serialise the file that defines `message` with all files it needs, dependencies first. Self-contained, so that
    any MCAP reader can decode the messages without our code.
    """
    files: dict[str, Any] = {}

    def collect(file: Any) -> None:
        if file.name not in files:
            for dependency in file.dependencies:
                collect(dependency)
            files[file.name] = file

    collect(message.DESCRIPTOR.file)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return result.SerializeToString(deterministic=True)


def timestamp(stamp_ns: int) -> Timestamp:
    """Return `stamp_ns` as a Protobuf time stamp."""
    seconds, nanos = divmod(stamp_ns, _NS_PER_S)
    return Timestamp(seconds=seconds, nanos=nanos)


def nanoseconds(stamp: Timestamp) -> int:
    """Return a Protobuf time stamp in ns. Raises DecodeError where it isn't between 1970 and what an int64 holds."""
    ns = stamp.seconds * _NS_PER_S + stamp.nanos
    if not 0 <= ns <= MAX_STAMP_NS:
        raise DecodeError(f"stamp of {stamp.seconds} s {stamp.nanos} ns is out of range")
    return ns


def parse(kind: type[M], data: bytes | memoryview) -> M:
    """Decode one Protobuf message. Raises DecodeError where `data` is no such message."""
    try:
        return kind.FromString(bytes(data))
    except (ProtobufError, UnicodeDecodeError) as error:
        raise DecodeError(f"not a {kind.DESCRIPTOR.full_name} ({error})") from error


_VARINT, _LENGTH = 0, 2
_FIXED = {1: 8, 5: 4}  # Bytes by wire type


def split(payload: memoryview, number: int) -> tuple[bytes, memoryview]:
    """Return the message without the bytes field `number`, and that field's value (the last one, as Protobuf has it).
    Raises DecodeError where the message is cut off or not Protobuf.
    """
    head: list[memoryview] = []
    value = payload[:0]
    kept, at, end = 0, 0, len(payload)
    while at < end:
        start = at
        tag, at = _varint(payload, at)
        kind = tag & 7
        if kind == _LENGTH:
            length, at = _varint(payload, at)
            if length > end - at:
                raise DecodeError(f"field {tag >> 3} of {length} bytes is cut off")
            if tag >> 3 == number:
                head.append(payload[kept:start])
                value = payload[at : at + length]
                kept = at + length
            at += length
        elif kind == _VARINT:
            _, at = _varint(payload, at)
        elif kind in _FIXED:
            at += _FIXED[kind]
        else:
            raise DecodeError(f"field {tag >> 3} has unknown wire type {kind}")
    if at > end:
        raise DecodeError("message is cut off")
    return b"".join([*head, payload[kept:]]), value


def _varint(payload: memoryview, at: int) -> tuple[int, int]:
    """Value at `at`, and where it ends."""
    value, shift = 0, 0
    while at < len(payload) and shift < 64:
        byte = payload[at]
        value |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return value, at
        shift += 7
    raise DecodeError("message is cut off")
