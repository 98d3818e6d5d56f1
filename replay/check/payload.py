"""Findings about the content of messages, counted in the fault log."""

import numpy as np

from fbench.replay.clean import clean
from fbench.replay.data import Image, Message, Pose, Rig
from fbench.replay.errors import DecodeError
from fbench.replay.faults import FaultLog
from fbench.replay.images import decode, encoded_size
from fbench.replay.raw_images import LAYOUTS
from fbench.replay.skipped import Skipped

_ENDS = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_TAIL = 1024
"""Some cameras pad their images; the end is looked for in so many bytes."""


def checked(message: Message, rig: Rig, faults: FaultLog, decode_images: bool) -> Message | Skipped:
    """Count what is wrong with a message; returns it as a pipeline would get it."""
    if isinstance(message, Image) and (why := _damage(message, decode_images)):
        faults.add("DEC002", f"{message.sensor} at {message.stamp_ns} ns: {why}")
    return clean(message, rig, faults)


def bad_pose(message: Message) -> bool:
    """Tell whether this is a pose that places the body nowhere."""
    if not isinstance(message, Pose):
        return False
    finite = np.isfinite(message.translation_m).all() and np.isfinite(message.rotation_xyzw).all()
    return not (finite and np.any(message.rotation_xyzw))


def _damage(image: Image, decode_images: bool) -> str:
    why = _raw_damage(image) if image.encoding in LAYOUTS else _header_damage(image)
    if not why and decode_images and decode(image) is None:
        return "can't be decoded"
    return why


def _raw_damage(image: Image) -> str:
    layout, (width, height) = LAYOUTS[image.encoding], image.size_wh
    wanted = layout.num_rows(height) * width * layout.pixel_bytes
    return "" if len(image.data) == wanted else f"{len(image.data)} bytes, but {width}x{height} px need {wanted}"


def _header_damage(image: Image) -> str:
    try:
        width, height = encoded_size(image.data)
    except DecodeError as error:
        return str(error)
    if (width, height) != image.size_wh:
        return f"{width}x{height} px, but {image.size_wh[0]}x{image.size_wh[1]} recorded"
    end = _ENDS.get(image.encoding)
    return "cut off" if end is not None and end not in image.data[-_TAIL:] else ""
