"""Decoding and encoding of images. OpenCV is imported when first needed."""

import struct

import numpy as np
from numpy.typing import NDArray

from fbench.replay.data import Image
from fbench.replay.errors import DecodeError
from fbench.replay.raw_images import LAYOUTS, raw_to_bgr

Pixels = NDArray[np.uint8]
MAX_PIXELS = 178_956_970
"""Larger images are refused before they are decoded (Pillow's limit for decompression bombs)."""

RAW_CHANNELS = {name: layout.pixel_bytes for name, layout in LAYOUTS.items()}
"""Bytes a pixel in a row of the raw layouts."""


def decode(image: Image) -> Pixels | None:
    """Decode to (H, W, 3) BGR uint8; `None` where the data are corrupt or their size isn't `size_wh`."""
    width, height = image.size_wh
    if width * height > MAX_PIXELS or width <= 0 or height <= 0:
        return None
    if image.encoding in LAYOUTS:
        return raw_to_bgr(image.data, image.encoding, image.size_wh)
    return _decode_compressed(image, is_grey=False)


def decode_grey(image: Image) -> Pixels | None:
    """Decode to (H, W) uint8; of a JPEG that is the brightness it stores, which takes less than half of the time.

    `None` as `decode` gives it.
    """
    if image.encoding not in LAYOUTS and max(image.size_wh) > 0 and image.size_wh[0] * image.size_wh[1] <= MAX_PIXELS:
        return _decode_compressed(image, is_grey=True)
    import cv2

    pixels = decode(image)
    return None if pixels is None else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)


def _decode_compressed(image: Image, *, is_grey: bool) -> Pixels | None:
    import cv2

    wanted = cv2.IMREAD_GRAYSCALE if is_grey else cv2.IMREAD_COLOR
    try:
        if encoded_size(image.data) != image.size_wh:
            return None
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), wanted | cv2.IMREAD_IGNORE_ORIENTATION)
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


def encoded_format(data: bytes | memoryview) -> str:
    """Return `jpeg`, `png` or `webp` as the first bytes say, whatever name an image has.

    Raises:
        DecodeError: where it is none of them.
    """
    head = bytes(data[:12])
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if head.startswith(b"\xff\xd8"):
        return "jpeg"
    if head.startswith(b"RIFF") and head.endswith(b"WEBP"):
        return "webp"
    raise DecodeError("neither a JPEG nor a PNG nor a WebP image")


def encoded_size(data: bytes) -> tuple[int, int]:
    """Width and height [px] as the header of a JPEG, PNG or WebP says, without decoding it.

    Raises:
        DecodeError: where it is none of them, or the header is damaged.
    """
    return _SIZES[encoded_format(data)](data)


def _png_size(data: bytes) -> tuple[int, int]:
    if len(data) < 24:
        raise DecodeError("PNG without a header")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


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


def _webp_size(data: bytes) -> tuple[int, int]:
    """Read the first chunk: RFC 9649, sections 2.5 (VP8), 2.6 (VP8L) and 2.7 (VP8X)."""
    kind, body = data[12:16], data[20:30]
    if kind == b"VP8X" and len(body) == 10:
        return int.from_bytes(body[4:7], "little") + 1, int.from_bytes(body[7:10], "little") + 1
    if kind == b"VP8L" and body[:1] == b"\x2f" and len(body) >= 5:
        bits = int.from_bytes(body[1:5], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 " and body[3:6] == b"\x9d\x01\x2a" and len(body) == 10:
        width, height = struct.unpack("<HH", body[6:10])
        return width & 0x3FFF, height & 0x3FFF
    raise DecodeError("WebP without a frame header")


_SIZES = {"png": _png_size, "jpeg": _jpeg_size, "webp": _webp_size}
