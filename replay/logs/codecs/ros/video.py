"""Video of Foxglove, of ffmpeg_image_transport and of the transports for H.264; Theora is refused by name."""

from typing import Any, Never

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.data.images import read_size, sniff_format
from fbench.replay.data.messages import Image
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.ros.cursor import Header, plain_frame
from fbench.replay.logs.codecs.ros.decoder import find, get, header, stamp_ns
from fbench.replay.logs.codecs.video.stream import peek_size, require_codec


def probe_video(message: Any, encoding: str) -> Probe:
    """Tell the coordinate frame. Raises UnsupportedError where the form of video isn't known."""
    name = _name(message)
    if not _is_jpeg(name):
        require_codec(name)
    return Probe("camera", _header(message, encoding).frame_id)


def read_video(kind: str, message: Any, encoding: str, origin: Origin) -> Image:
    """Return the packet of one picture; its size is zero where neither message nor packet tells it. Raises DecodeError
    where the message lacks a field, UnsupportedError where the form of video isn't known.
    """
    data, name, stamp_ns = bytes(get(message, "data")), _name(message), _header(message, encoding).stamp_ns
    if _is_jpeg(name):
        codec, size_wh = sniff_format(data), read_size(data)
    else:
        codec = require_codec(name)
        given = int(find(message, "width", "img_width") or 0), int(find(message, "height", "img_height") or 0)
        size_wh = given if min(given) > 0 else peek_size(codec, data)
    return Image(origin.sensor, stamp_ns, origin.log_ns, data, codec, size_wh, origin.frame_number)


def _name(message: Any) -> str:
    """Form of the video as the writer names it; transports for H.264 alone don't."""
    return str(find(message, "format", "encoding") or "h264")


def _is_jpeg(name: str) -> bool:
    return "mjpeg" in name.lower()


def _header(message: Any, encoding: str) -> Header:
    """Stamp and coordinate frame: Foxglove has no header."""
    if (stamp := find(message, "timestamp")) is None:
        return header(message, encoding)
    return Header(stamp_ns(stamp, encoding), plain_frame(str(get(message, "frame_id"))))


def refuse_theora(message: Any, encoding: str) -> Never:
    """Refuse Theora. Raises UnsupportedError."""
    raise UnsupportedError("its video is Theora, which isn't supported; record images, or another transport")
