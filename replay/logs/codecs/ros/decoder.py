"""Decoding of ROS messages: through rosbags, unless their bytes are read here, and what a message can be read as."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1, Header, nanoseconds, plain_frame
from fbench.replay.logs.codecs.ros.definitions import Types
from fbench.replay.logs.coordinate_frames import Edge

MAX_BYTES = 8 * 1024 * 1024  # Of a message without bulk data; 10,000 detections have less


Decode = Callable[[memoryview], Any]


def decoder(name: str, types: Types, encoding: str) -> Decode:
    """Return a function from payloads to message objects, whose attributes are the fields.

    The function raises DecodeError where a payload is damaged or larger than `MAX_BYTES`. Raises DecodeError where
    rosbags can't make code of the types.
    """
    from rosbags.typesys.store import Typestore

    store = Typestore()
    _register(store, name, types)
    read = store.deserialize_cdr if encoding == CDR else store.deserialize_ros1
    return lambda data: _decode(read, name, data)


def _register(store: Any, name: str, types: Types) -> None:
    from rosbags.typesys import TypesysError

    try:
        store.register(types)
        store.get_msgdef(name)
    except TypesysError as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error
    except (ValueError, TypeError, AssertionError, KeyError, RecursionError) as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error


def _decode(read: Callable[[memoryview, str], object], name: str, data: memoryview) -> Any:
    from rosbags.serde import SerdeError

    if len(data) > MAX_BYTES:
        raise DecodeError(f"{name} of {len(data)} bytes, more than {MAX_BYTES}")
    try:
        return read(data, name)
    except SerdeError as error:
        raise DecodeError(str(error).rstrip(".")) from error
    except (struct.error, ValueError, IndexError, TypeError, AssertionError, KeyError, OverflowError) as error:
        raise DecodeError(f"not a {name} ({error})") from error


def get(message: Any, *names: str) -> Any:
    """The first of these fields that a message has. Raises DecodeError where it has none."""
    value = find(message, *names)
    if value is None:
        raise DecodeError(f"message has no field '{names[0]}'")
    return value


def find(message: Any, *names: str) -> Any:
    """The first of these fields that a message has, else `None`."""
    fields: dict[str, Any] = vars(message)
    return next((fields[name] for name in names if name in fields), None)


def header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame of a message with a header; seconds of ROS 1 are unsigned. Raises DecodeError where it
    has no header, or the stamp is out of range.
    """
    part = get(message, "header")
    stamp = get(part, "stamp")
    sec = get(stamp, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(stamp, "sec")
    return Header(nanoseconds(sec, get(stamp, "nanosec")), plain_frame(get(part, "frame_id")))


@dataclass(frozen=True)
class MessageReader:
    """Functions from the payloads of one type to what they hold; `None` where a type holds no such thing."""

    kinds: tuple[str, ...]
    probe: Callable[[memoryview], Probe]
    message: Callable[[str, memoryview, Origin], Message] | None = None
    transforms: Callable[[memoryview], Sequence[tuple[str, Edge]]] | None = None
    stamps: Callable[[memoryview], Sequence[int]] | None = None  # Of the transforms
    calibration: Callable[[memoryview], tuple[str, CameraModel]] | None = None
    truth: Callable[[memoryview, Origin], TruthPart] | None = None


def probe_header(kind: str, decode: Decode, encoding: str) -> Callable[[memoryview], Probe]:
    """Return a probe that finds the coordinate frame in the header."""
    return lambda data: Probe(kind, header(decode(data), encoding).frame_id)
