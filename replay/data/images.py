"""Decoding and encoding of images, and the layouts of raw ones. OpenCV is imported when first needed."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fbench.replay.contracts.errors import DecodeError, DepthError, UnsupportedError
from fbench.replay.data.messages import Image

Pixels = NDArray[np.uint8]
MAX_PIXELS = 178_956_970  # Larger images are refused before they are decoded (Pillow's limit for decompression bombs)


@dataclass(frozen=True)
class Layout:
    """How the pixels of one row follow each other."""

    channels: int  # Samples a pixel
    conversion: str = ""  # Name of OpenCV's conversion to BGR; empty: none is needed
    sample_bytes: int = 1
    even: tuple[int, int] = (1, 1)  # Width and height are multiples of these [px]
    rows: tuple[int, int] = (1, 1)
    """Rows in memory a row of the image, as a fraction: planes of color follow that of brightness."""

    @property
    def pixel_bytes(self) -> int:
        """Bytes a pixel in a row."""
        return self.channels * self.sample_bytes

    def num_rows(self, height: int) -> int:
        """Rows in memory of an image `height` px high."""
        return height * self.rows[0] // self.rows[1]


_COLOURS: Mapping[str, tuple[int, str]] = {
    "mono": (1, "COLOR_GRAY2BGR"), "bgr": (3, ""), "rgb": (3, "COLOR_RGB2BGR"), "bgra": (4, "COLOR_BGRA2BGR"),
    "rgba": (4, "COLOR_RGBA2BGR"), "bayer_rggb": (1, "COLOR_BayerRGGB2BGR"), "bayer_bggr": (1, "COLOR_BayerBGGR2BGR"),
    "bayer_gbrg": (1, "COLOR_BayerGBRG2BGR"), "bayer_grbg": (1, "COLOR_BayerGRBG2BGR"),
}  # fmt: skip
# Bayer names are those of the first two pixels of the first two rows, in ROS as in OpenCV's longer names; its short
# ones (BayerBG2BGR for rggb) begin at the second pixel of the second row.

LAYOUTS: Mapping[str, Layout] = {
    **{f"{name}8": Layout(channels, code) for name, (channels, code) in _COLOURS.items()},
    **{f"{name}16": Layout(channels, code, 2) for name, (channels, code) in _COLOURS.items()},
    "uyvy": Layout(2, "COLOR_YUV2BGR_UYVY", even=(2, 1)),
    "yuyv": Layout(2, "COLOR_YUV2BGR_YUY2", even=(2, 1)),
    "nv21": Layout(1, "COLOR_YUV2BGR_NV21", even=(2, 2), rows=(3, 2)),
}
"""Raw layouts by name; samples of 16 bits are little-endian."""
RAW_CHANNELS = {name: layout.pixel_bytes for name, layout in LAYOUTS.items()}
"""Bytes a pixel in a row of the raw layouts."""
_OTHER_NAMES: Mapping[str, str] = {
    "8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC3": "bgr16", "16UC4": "bgra16",
    "yuv422": "uyvy", "yuv422_yuy2": "yuyv",
}  # fmt: skip
DEPTH = ("16UC1", "32FC1")  # [mm] and [m], REP 118


def layout_name(encoding: str) -> str:
    """Return the one name of a raw layout that ROS and OpenCV give several: `uyvy` for `yuv422`, `bgr8` for `8UC3`.
    Raises UnsupportedError where it isn't in `LAYOUTS`, or is that of depth images.
    """
    if encoding in DEPTH:
        raise DepthError(f"image encoding '{encoding}' is that of a depth image, not supported")
    name = _OTHER_NAMES.get(encoding, encoding)
    if name not in LAYOUTS:
        raise UnsupportedError(f"image encoding '{encoding}' isn't supported, only {', '.join(LAYOUTS)}")
    return name


def pack_rows(
    data: memoryview, encoding: str, size_wh: tuple[int, int], step: int, *, is_bigendian: bool = False
) -> bytes:
    """Pack rows of `step` bytes of a layout, little-endian. Raises DecodeError where size, step and data don't fit."""
    layout, (width, height) = LAYOUTS[encoding], size_wh
    row, rows = width * layout.pixel_bytes, layout.num_rows(height)
    if width % layout.even[0] or height % layout.even[1]:
        raise DecodeError(f"{encoding} image of {width}x{height} px, its sides must be even")
    if len(data) == row * rows:
        step = row
    if min(width, height) <= 0 or step < row or len(data) != step * rows:
        raise DecodeError(f"{encoding} image of {width}x{height} px with rows of {step} bytes has {len(data)} bytes")
    swapped = is_bigendian and layout.sample_bytes == 2
    if step == row and not swapped:
        return bytes(data)
    pixels = np.frombuffer(data, np.uint8).reshape(rows, step)[:, :row]
    if swapped:
        pixels = pixels.reshape(rows, row // 2, 2)[..., ::-1]
    return pixels.tobytes()


def decode(image: Image) -> Pixels | None:
    """Decode to (H, W, 3) BGR uint8, of raw 16 bits the upper 8; `None` where data are corrupt or sizes don't fit.
    Raises MissingPackageError where it is a picture of a video, and PyAV isn't installed.
    """
    if image.video is not None:
        return image.video.decode()
    width, height = image.size_wh
    if width * height > MAX_PIXELS or width <= 0 or height <= 0:
        return None
    if image.encoding not in LAYOUTS:
        return _decode_compressed(image, is_grey=False)
    import cv2

    layout, rows = LAYOUTS[image.encoding], LAYOUTS[image.encoding].num_rows(height)
    fits = width % layout.even[0] == 0 and height % layout.even[1] == 0
    if not fits or len(image.data) != rows * width * layout.pixel_bytes:
        return None
    samples = np.frombuffer(image.data, np.uint8).reshape(rows, width, layout.channels, layout.sample_bytes)
    pixels = np.ascontiguousarray(samples[..., 0, -1] if layout.channels == 1 else samples[..., -1])
    if not layout.conversion:
        return pixels
    try:
        return np.asarray(cv2.cvtColor(pixels, getattr(cv2, layout.conversion)), np.uint8)
    except cv2.error:
        return None


def decode_grey(image: Image) -> Pixels | None:
    """Decode to (H, W) uint8; of a JPEG that is the brightness it stores, which takes less than half of the time.
    `None` as `decode` gives it.
    """
    if image.video is not None:
        return image.video.decode_grey()
    if image.encoding not in LAYOUTS and max(image.size_wh) > 0 and image.size_wh[0] * image.size_wh[1] <= MAX_PIXELS:
        return _decode_compressed(image, is_grey=True)
    import cv2

    pixels = decode(image)
    return None if pixels is None else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)


def _decode_compressed(image: Image, *, is_grey: bool) -> Pixels | None:
    import cv2

    wanted = cv2.IMREAD_GRAYSCALE if is_grey else cv2.IMREAD_COLOR
    try:
        if read_size(image.data) != image.size_wh:
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


def encode_png(pixels: Pixels) -> bytes:
    """Encode (H, W, 3) BGR as PNG, without loss."""
    import cv2

    ok, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise DecodeError(f"image of shape {pixels.shape} can't be encoded as PNG")
    return bytes(data.tobytes())


def scale_down(pixels: Pixels, max_width: int) -> Pixels:
    """Scale (H, W, 3) down to at most `max_width` [px]; smaller images stay as they are."""
    import cv2

    height, width = pixels.shape[:2]
    if width <= max_width:
        return pixels
    size = (max_width, max(1, round(height * max_width / width)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def sniff_format(data: bytes | memoryview) -> str:
    """Return `jpeg`, `png` or `webp` as the first bytes say. Raises DecodeError where an image is none of them."""
    head = bytes(data[:12])
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if head.startswith(b"\xff\xd8"):
        return "jpeg"
    if head.startswith(b"RIFF") and head.endswith(b"WEBP"):
        return "webp"
    raise DecodeError("neither a JPEG nor a PNG nor a WebP image")


def is_picture(data: bytes | memoryview) -> bool:
    """Tell whether the first bytes are those of a JPEG, PNG or WebP, whatever a message calls it."""
    try:
        return bool(sniff_format(data))
    except DecodeError:
        return False


def read_size(data: bytes) -> tuple[int, int]:
    """Width and height [px] as the header says. Raises DecodeError for other formats, or where it is damaged."""
    return _SIZES[sniff_format(data)](data)


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
