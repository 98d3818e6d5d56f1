"""Decoding and encoding of images. OpenCV is imported when first needed."""

import struct

import numpy as np
from numpy.typing import NDArray

from fbench.replay.data import Image
from fbench.replay.errors import DecodeError

Pixels = NDArray[np.uint8]
MAX_PIXELS = 178_956_970
"""Larger images are refused before they are decoded (Pillow's limit for decompression bombs)."""

RAW_CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1}
"""Bytes a pixel of the raw layouts."""


def decode(image: Image) -> Pixels | None:
    """Decode to (H, W, 3) BGR uint8; `None` where the data are corrupt or their size isn't `size_wh`."""
    width, height = image.size_wh
    if width * height > MAX_PIXELS or width <= 0 or height <= 0:
        return None
    if image.encoding in RAW_CHANNELS:
        return _decode_raw(image, RAW_CHANNELS[image.encoding])
    return _decode_compressed(image)


def _decode_raw(image: Image, channels: int) -> Pixels | None:
    width, height = image.size_wh
    if len(image.data) != width * height * channels:
        return None
    pixels = np.frombuffer(image.data, np.uint8).reshape(height, width, channels)
    if image.encoding == "bgr8":
        return pixels
    return np.ascontiguousarray(pixels[..., ::-1] if channels == 3 else np.repeat(pixels, 3, axis=2))


def _decode_compressed(image: Image) -> Pixels | None:
    import cv2

    try:
        if encoded_size(image.data) != image.size_wh:
            return None
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (DecodeError, cv2.error):
        return None
    return pixels if pixels is not None and pixels.shape[:2] == image.size_wh[::-1] else None


def encode_jpeg(pixels: Pixels, quality: int = 80) -> bytes:
    """Encode (H, W, 3) BGR as JPEG."""
    import cv2

    ok, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise DecodeError(f"image of shape {pixels.shape} can't be encoded as JPEG")
    return bytes(data.tobytes())


def resized(pixels: Pixels, max_width: int) -> Pixels:
    """Scale (H, W, 3) down to at most `max_width` [px]; smaller images stay as they are."""
    import cv2

    height, width = pixels.shape[:2]
    if width <= max_width:
        return pixels
    size = (max_width, max(1, round(height * max_width / width)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def encoded_size(data: bytes) -> tuple[int, int]:
    """Width and height [px] as the header of a JPEG or PNG says, without decoding it.

    Raises:
        DecodeError: where it is neither, or the header is damaged.
    """
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return width, height
    if data[:2] == b"\xff\xd8":
        return _jpeg_size(data)
    raise DecodeError("neither a JPEG nor a PNG image")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        else:
            at += 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]
    raise DecodeError("JPEG without a frame header")
