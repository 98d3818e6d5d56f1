"""Decoding small messages of any definition through rosbags."""

import struct
from collections.abc import Callable
from typing import Any

from fbench.replay.errors import DecodeError
from fbench.replay.logs.ros.cursor import CDR
from fbench.replay.logs.ros.definitions import Types

MAX_BYTES = 8 * 1024 * 1024
"""Of a message without bulk data; 10,000 detections have less."""

Decode = Callable[[memoryview], Any]


def decoder(name: str, types: Types, encoding: str) -> Decode:
    """Return a function from payloads to message objects, whose attributes are the fields.

    The function raises DecodeError where a payload is damaged or larger than `MAX_BYTES`.

    Raises:
        DecodeError: where rosbags can't make code of the types.
    """
    from rosbags.typesys.store import Typestore

    store = Typestore()
    _register(store, name, types)
    read = store.deserialize_cdr if encoding == CDR else store.deserialize_ros1
    return lambda data: _decoded(read, name, data)


def _register(store: Any, name: str, types: Types) -> None:
    from rosbags.typesys import TypesysError

    try:
        store.register(types)
        store.get_msgdef(name)
    except TypesysError as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error
    except (ValueError, TypeError, AssertionError, KeyError, RecursionError) as error:
        raise DecodeError(f"definition of {name} can't be used ({error})") from error


def _decoded(read: Callable[[memoryview, str], object], name: str, data: memoryview) -> Any:
    from rosbags.serde import SerdeError

    if len(data) > MAX_BYTES:
        raise DecodeError(f"{name} of {len(data)} bytes, more than {MAX_BYTES}")
    try:
        return read(data, name)
    except SerdeError as error:
        raise DecodeError(str(error).rstrip(".")) from error
    except (struct.error, ValueError, IndexError, TypeError, AssertionError, KeyError, OverflowError) as error:
        raise DecodeError(f"not a {name} ({error})") from error
