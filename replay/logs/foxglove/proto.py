"""What all Protobuf codecs share: schemas with their dependencies, time stamps, parsing."""

from typing import Any, TypeVar

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError as ProtobufError
from google.protobuf.message import Message as Proto
from google.protobuf.timestamp_pb2 import Timestamp

from fbench.replay.errors import DecodeError

_NS_PER_S = 1_000_000_000
MAX_STAMP_NS = 2**63 - 1

M = TypeVar("M", bound=Proto)


def descriptor_set(message: type[Proto]) -> bytes:
    """Serialise the file that defines `message` with all files it needs, dependencies first.

    Self-contained, so that any MCAP reader can decode the messages without our code.
    """
    files: dict[str, Any] = {}
    _collect(message.DESCRIPTOR.file, files)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return result.SerializeToString(deterministic=True)


def _collect(file: Any, files: dict[str, Any]) -> None:
    if file.name in files:
        return
    for dependency in file.dependencies:
        _collect(dependency, files)
    files[file.name] = file


def timestamp(stamp_ns: int) -> Timestamp:
    """Return `stamp_ns` as a Protobuf time stamp."""
    seconds, nanos = divmod(stamp_ns, _NS_PER_S)
    return Timestamp(seconds=seconds, nanos=nanos)


def nanoseconds(stamp: Timestamp) -> int:
    """Return a Protobuf time stamp in ns.

    Raises:
        DecodeError: where it isn't between 1970 and what an int64 holds.
    """
    ns = stamp.seconds * _NS_PER_S + stamp.nanos
    if not 0 <= ns <= MAX_STAMP_NS:
        raise DecodeError(f"stamp of {stamp.seconds} s {stamp.nanos} ns is out of range")
    return ns


def parse(kind: type[M], data: bytes | memoryview) -> M:
    """Decode one Protobuf message.

    Raises:
        DecodeError: where `data` is no such message.
    """
    try:
        return kind.FromString(bytes(data))
    except (ProtobufError, UnicodeDecodeError) as error:
        raise DecodeError(f"not a {kind.DESCRIPTOR.full_name} ({error})") from error
