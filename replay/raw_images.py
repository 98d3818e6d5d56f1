"""Raw image layouts: their names, how rows are packed, and their conversion to BGR."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fbench.replay.errors import DecodeError, UnsupportedError

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Layout:
    """How the pixels of one row follow each other."""

    channels: int
    """Samples a pixel."""
    conversion: str = ""
    """Name of OpenCV's conversion to BGR; empty: none is needed."""
    sample_bytes: int = 1
    even: tuple[int, int] = (1, 1)
    """Width and height are multiples of these [px]."""
    rows: tuple[int, int] = (1, 1)
    """Rows in memory a row of the image, as a fraction: planes of colour follow that of brightness."""

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

_OTHER_NAMES: Mapping[str, str] = {
    "8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC1": "mono16", "16UC3": "bgr16", "16UC4": "bgra16",
    "yuv422": "uyvy", "yuv422_yuy2": "yuyv",
}  # fmt: skip


def layout_name(encoding: str) -> str:
    """Return the one name of a raw layout that ROS and OpenCV give several: `uyvy` for `yuv422`, `bgr8` for `8UC3`.

    Raises:
        DecodeError: where it isn't in `LAYOUTS`.
    """
    name = _OTHER_NAMES.get(encoding, encoding)
    if name not in LAYOUTS:
        raise UnsupportedError(f"image encoding '{encoding}' isn't supported, only {', '.join(LAYOUTS)}")
    return name


def packed(
    data: memoryview, encoding: str, size_wh: tuple[int, int], step: int, *, is_bigendian: bool = False
) -> bytes:
    """Copy an image of layout `encoding` without the padding at the end of its rows of `step` bytes, little-endian.

    Raises:
        DecodeError: where size, step and data don't fit together.
    """
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


def raw_to_bgr(data: bytes, encoding: str, size_wh: tuple[int, int]) -> Pixels | None:
    """Convert packed pixels to (H, W, 3) BGR; of 16 bits the upper 8 count. `None` where sizes don't fit."""
    layout, (width, height) = LAYOUTS[encoding], size_wh
    rows = layout.num_rows(height)
    fits = width % layout.even[0] == 0 and height % layout.even[1] == 0
    if not fits or len(data) != rows * width * layout.pixel_bytes:
        return None
    samples = np.frombuffer(data, np.uint8).reshape(rows, width, layout.channels, layout.sample_bytes)
    return _converted(samples[..., -1], layout)


def _converted(samples: Pixels, layout: Layout) -> Pixels | None:
    if not layout.conversion:
        return np.ascontiguousarray(samples)
    import cv2

    pixels = samples[..., 0] if layout.channels == 1 else samples
    try:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, layout.conversion)), np.uint8)
    except cv2.error:
        return None
