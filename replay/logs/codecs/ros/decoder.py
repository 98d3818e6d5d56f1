"""Decoding of ROS messages: through rosbags, unless their bytes are read here, and access to their fields."""

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1, Header, nanoseconds, plain_frame
from fbench.replay.logs.codecs.ros.definitions import Types

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

MAX_BYTES = 8 * 1024 * 1024  # Of a message without bulk data; 10,000 detections have less

Decode = Callable[[memoryview], Any]


def decoder(name: str, types: Types, encoding: str, limit: int = MAX_BYTES) -> Decode:
    """Return a function from payloads to message objects, whose attributes are the fields. The function raises
    DecodeError where a payload is damaged or larger than `limit` [byte]. Raises DecodeError where rosbags can't make
    code of the types.
    """
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    store = _decoding_store(encoding)
    try:
        store.register(types)
        for part in types:
            store.get_msgdef(part)
    except (TypesysError, ValueError, TypeError, AssertionError, KeyError, RecursionError) as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error
    read = store.deserialize_cdr if encoding == CDR else store.deserialize_ros1

    def decode(data: memoryview) -> object:
        if len(data) > limit:
            raise DecodeError(f"{name} of {len(data)} bytes, more than {limit}")
        try:
            return read(data, name)
        except SerdeError as error:
            raise DecodeError(str(error).rstrip(".")) from error
        except (struct.error, ValueError, IndexError, TypeError, AssertionError, KeyError, OverflowError) as error:
            raise DecodeError(f"not a {name} ({error})") from error

    return decode


def _decoding_store(encoding: str) -> "Typestore":
    """A store of rosbags that compiles what decodes messages of this encoding alone. Its own also encodes, measures and
    converts, and compiles fourteen functions for each type, of which one or two are used.
    """
    from rosbags.interfaces import Msgdef
    from rosbags.serde.cdr import generate_deserialize_cdr
    from rosbags.serde.ros1 import generate_deserialize_ros1
    from rosbags.typesys.base import normalize_fieldname
    from rosbags.typesys.store import Typestore

    def _refuse(*_: object) -> Any:
        raise NotImplementedError

    refuse: Any = _refuse

    class DecodingStore(Typestore):
        def get_msgdef(self, typename: str) -> Msgdef[object]:
            if typename not in self.cache:
                fields = [(normalize_fieldname(name), what) for name, what in self.fielddefs[typename][1]]
                little = big = ros1 = refuse
                if encoding == CDR:
                    little, big = (generate_deserialize_cdr(fields, self, order) for order in ("le", "be"))
                else:
                    ros1 = generate_deserialize_ros1(fields, self)
                self.cache[typename] = Msgdef(
                    typename, fields, self.types[typename],
                    0, refuse, refuse, refuse, little, big,
                    0, refuse, refuse, ros1,
                    refuse, refuse, refuse, refuse,
                )  # fmt: skip
            return self.cache[typename]

    return DecodingStore()


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


def stamp_ns(time: Any, encoding: str) -> int:
    """A time in ns; seconds of ROS 1 are unsigned. Raises DecodeError where it is out of range."""
    sec = get(time, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(time, "sec")
    return nanoseconds(sec, get(time, "nanosec"))


def header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame. Raises DecodeError without a header, or where the stamp is out of range."""
    part = get(message, "header")
    return Header(stamp_ns(get(part, "stamp"), encoding), plain_frame(get(part, "frame_id")))
