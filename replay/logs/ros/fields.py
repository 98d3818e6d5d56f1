"""Fields of decoded message objects, whose definitions differ between generations of a message."""

from typing import Any

from fbench.replay.errors import DecodeError
from fbench.replay.logs.ros.cursor import ROS1, Header, nanoseconds, plain_frame


def get(message: Any, *names: str) -> Any:
    """The first of these fields that a message has.

    Raises:
        DecodeError: where it has none.
    """
    value = find(message, *names)
    if value is None:
        raise DecodeError(f"message has no field '{names[0]}'")
    return value


def find(message: Any, *names: str) -> Any:
    """The first of these fields that a message has, else `None`."""
    fields: dict[str, Any] = vars(message)
    return next((fields[name] for name in names if name in fields), None)


def header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame of a message with a header; seconds of ROS 1 are unsigned.

    Raises:
        DecodeError: where it has no header, or the stamp is out of range.
    """
    part = get(message, "header")
    stamp = get(part, "stamp")
    sec = get(stamp, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(stamp, "sec")
    return Header(nanoseconds(sec, get(stamp, "nanosec")), plain_frame(get(part, "frame_id")))
