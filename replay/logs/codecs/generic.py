"""Messages of any type by the definition that the log carries: ROS, Protobuf, JSON. Both are untrusted."""

from collections.abc import Callable
from graphlib import CycleError, TopologicalSorter
from typing import Any

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor import Descriptor
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError as ProtobufError

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.foxglove.json_messages import parse_json
from fbench.replay.logs.container import Channel, Schema

_MAX_BULK = 256 * 2**20  # As of records: such messages take little more than their bytes
_MAX_BYTES = 8 * 2**20  # Of others, whose smallest parts take a hundred times as much when they are parsed
_MAX_DEFINITION, _MAX_FILES = 4 * 2**20, 1000

Parse = Callable[[memoryview], Any]


def parser_of(channel: Channel, definition: str = "") -> Parse:
    """Return a function from payloads of a channel to messages, which raises DecodeError where one is damaged;
    `definition` is that of a ROS type for logs without it. Raises DecodeError where there is no definition, or it can't
    be used.
    """
    if channel.encoding in ("cdr", "ros1"):
        return _ros_parser(channel, definition)
    if channel.encoding == "protobuf":
        return _protobuf_parser(channel)
    if channel.encoding == "json":
        return parse_json
    raise DecodeError(f"encoding '{channel.encoding}' has no general decoder; read the bytes, `payload.data`")


def _ros_parser(channel: Channel, definition: str) -> Parse:
    from fbench.replay.logs.codecs.ros.decoder import decoder
    from fbench.replay.logs.codecs.ros.definitions import full_name, has_bulk_only, has_text, types_of

    name, schema = full_name(channel.schema_name), channel.schema
    if definition and not has_text(schema):
        schema = Schema(name, "ros2msg" if channel.encoding == "cdr" else "ros1msg", definition.encode())
    types = types_of(name, schema, channel.encoding)
    return decoder(name, types, channel.encoding, _MAX_BULK if has_bulk_only(types) else _MAX_BYTES)


def _protobuf_parser(channel: Channel) -> Parse:
    name, schema = channel.schema_name, channel.schema
    if schema is None or not schema.data:
        raise DecodeError(f"definition of {name or 'its type'} is missing")
    if len(schema.data) > _MAX_DEFINITION:
        raise DecodeError(f"definition of {name} has {len(schema.data)} bytes, more than {_MAX_DEFINITION}")
    try:
        files = FileDescriptorSet.FromString(schema.data).file
        pool = descriptor_pool.DescriptorPool()
        for file in _sort_files(files):
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(name)
        kind = message_factory.GetMessageClass(descriptor)
    except (ProtobufError, TypeError, KeyError, ValueError, CycleError) as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error
    limit = _MAX_BYTES if _repeats_parts(descriptor) else _MAX_BULK

    def parse(data: memoryview) -> Any:
        if len(data) > limit:
            raise DecodeError(f"{name} of {len(data)} bytes, more than {limit}")
        try:
            return kind.FromString(bytes(data))
        except (ProtobufError, ValueError) as error:
            raise DecodeError(f"not a {name} ({error})") from error

    return parse


def _sort_files(files: Any) -> list[FileDescriptorProto]:
    """Put each file behind those that it imports, which other writers don't always do."""
    by_name: dict[str, FileDescriptorProto] = {file.name: file for file in files}
    if len(by_name) > _MAX_FILES:
        raise ValueError(f"{len(by_name)} files, more than {_MAX_FILES}")
    order = TopologicalSorter({name: sorted(file.dependency) for name, file in sorted(by_name.items())}).static_order()
    return [by_name[name] for name in order if name in by_name]


def _repeats_parts(descriptor: Descriptor) -> bool:
    """Tell whether messages of a type can hold any number of parts that aren't numbers."""
    waiting, known = [descriptor], {descriptor.full_name}
    while waiting:
        for field in waiting.pop().fields:
            inner = field.message_type
            if field.is_repeated and (inner is not None or field.type in (field.TYPE_STRING, field.TYPE_BYTES)):
                return True
            if inner is not None and inner.full_name not in known:
                known.add(inner.full_name)
                waiting.append(inner)
    return False
