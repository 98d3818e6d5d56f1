"""Pictures of a video: each is decoded after those before it, from the last keyframe on. PyAV is imported when a
picture is wanted.

A picture is a function of the packets from its keyframe on, whatever was decoded before, in which order, and by whom;
that a decoder goes on where it stopped only saves time. So it doesn't matter which pictures a pipeline looks at.
"""

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fbench.replay.contracts.errors import MissingPackageError

if TYPE_CHECKING:
    from av.codec.context import CodecContext
    from av.video.frame import VideoFrame

CODECS: Mapping[str, str] = {"h264": "h264", "h265": "hevc", "vp9": "vp9", "av1": "libdav1d"}
"""What FFmpeg calls the decoder of each form of video."""
MAX_STRETCH_BYTES = 64 * 1024 * 1024  # Packets that are kept from a keyframe on
Pixels = NDArray[np.uint8]
Plane = NDArray[np.uint8] | NDArray[np.uint16]


class Source(Protocol):
    """Gives the pictures of a video."""

    def frame(self, index: int) -> "VideoFrame | None":
        """Return a picture by its place; `None` where it is damaged. Raises MissingPackageError without PyAV."""


@dataclass(frozen=True, eq=False)
class VideoPicture:
    """Where the picture of a packet comes from."""

    source: Source | None = None
    index: int = 0
    damage: str = ""  # Why there is no picture; empty: it can be decoded, as far as headers tell
    is_lost: bool = True  # Whether what it lacks was lost, or was never recorded

    @property
    def is_start(self) -> bool:
        """Whether decoding begins with it."""
        return self.index == 0 and isinstance(self.source, Stretch)

    def decode(self) -> Pixels | None:
        """Decode to (H, W, 3) BGR uint8; `None` where it is damaged. Raises MissingPackageError without PyAV."""
        return None if (frame := self._frame()) is None else _to_bgr(frame)

    def decode_grey(self) -> Pixels | None:
        """Decode to (H, W) uint8, the brightness that the video stores."""
        return None if (frame := self._frame()) is None else _to_grey(frame)

    def _frame(self) -> "VideoFrame | None":
        return None if self.source is None or self.damage else self.source.frame(self.index)


def import_av() -> ModuleType:
    """Return PyAV. Raises MissingPackageError where it isn't installed."""
    try:
        import av
        import av.logging
    except ImportError as error:
        why = f"a log has video, which needs PyAV ({error}): pip install 'fbench[video]'"
        raise MissingPackageError(why) from error
    found: ModuleType = av
    return found


class Decoder:
    """Decodes the packets of one video in their order, in one thread. Raises MissingPackageError without PyAV."""

    def __init__(self, codec: str, size_wh: tuple[int, int]) -> None:
        self._av, self._size_wh = import_av(), size_wh
        context: CodecContext = self._av.CodecContext.create(CODECS[codec], "r")
        context.thread_count = 1
        context.options = {"max_pixels": str((size_wh[0] + 128) * (size_wh[1] + 128))}  # coded in whole blocks
        self._context = context

    def decode(self, packet: bytes) -> "VideoFrame | None":
        """Decode the next packet; `None` where that doesn't give one whole picture."""
        try:
            frames = self._context.decode(self._av.Packet(packet))  # type: ignore[attr-defined]
        except (self._av.FFmpegError, MemoryError):
            return None
        if len(frames) != 1 or frames[0].is_corrupt or (frames[0].width, frames[0].height) != self._size_wh:
            return None
        frame: VideoFrame = frames[0]
        return frame if frame.format.name in _FORMATS else None


class Stretch:
    """The packets of a video from one with which decoding can begin. Safe to use from several threads."""

    def __init__(self, codec: str, size_wh: tuple[int, int], whole_from: int = 0) -> None:
        self.codec, self.size_wh = codec, size_wh
        self.packets: list[bytes] = []
        self.num_bytes = 0
        self._whole_from = whole_from  # Pictures before this one are still being built
        self._lock = threading.Lock()
        self._decoder: Decoder | None = None
        self._next, self._failed = 0, 2**63
        self._last: tuple[int, VideoFrame | None] = (-1, None)

    def add(self, packet: bytes) -> int:
        """Append a packet; return its place."""
        self.packets.append(packet)
        self.num_bytes += len(packet)
        return len(self.packets) - 1

    def frame(self, index: int) -> "VideoFrame | None":
        """Decode the picture of a packet, and what it needs; all are damaged from the first damaged one on."""
        with self._lock:
            if index >= self._failed:
                return None
            if self._last[0] == index:
                return self._last[1]
            if self._decoder is None or index < self._next:
                self._decoder, self._next = Decoder(self.codec, self.size_wh), 0
            frame = None
            while self._next <= index:
                at, self._next = self._next, self._next + 1
                frame = self._decoder.decode(self.packets[at])
                if frame is None and at >= self._whole_from:
                    self._failed, self._decoder = at, None
                    return None
            self._last = (index, frame)
            return frame


class _Yuv(NamedTuple):
    """How a picture lies in its planes."""

    steps: tuple[int, int] = (1, 1)  # Pixels across and down that share a sample of color
    depth: int = 8
    is_full: bool = False  # Whether brightness goes from 0 on, as in JPEG


_SAMPLINGS = {"420": (2, 2), "422": (2, 1), "444": (1, 1), "440": (1, 2)}
_FORMATS: Mapping[str, _Yuv | None] = {
    **{f"yuv{name}p": _Yuv(steps) for name, steps in _SAMPLINGS.items()},
    **{f"yuvj{name}p": _Yuv(steps, is_full=True) for name, steps in _SAMPLINGS.items()},
    **{f"yuv{name}p{bits}le": _Yuv(steps, bits) for name, steps in _SAMPLINGS.items() for bits in (10, 12)},
    "gray": None, "gray10le": None, "gray12le": None, "gbrp": None,
}  # fmt: skip
"""Forms of pictures by FFmpeg's names; `None`: without samples of color of their own."""
_FULL_RANGE = 2  # FFmpeg's number
_WEIGHTS: Mapping[int, tuple[float, float]] = {1: (0.2126, 0.0722), 7: (0.212, 0.087), 9: (0.2627, 0.0593),
                                               10: (0.2627, 0.0593)}  # fmt: skip
"""Weights of red and blue in brightness by `matrix_coefficients` of ITU-T H.273, table 4."""
_BT601 = (0.299, 0.114)  # Also where a video doesn't say: FFmpeg and OpenCV take it, too


def _planes(frame: "VideoFrame") -> list[Plane]:
    """Planes (H, W) of a picture, as views."""
    found: list[Plane] = []
    for plane in frame.planes:
        dtype = np.uint16 if frame.format.name.endswith("le") else np.uint8
        rows = np.frombuffer(plane, dtype)  # type: ignore[call-overload]  # it has the buffer protocol
        rows = rows[: plane.height * plane.line_size // dtype().itemsize].reshape(plane.height, -1)
        found.append(rows[:, : plane.width])
    return found


def _depth(frame: "VideoFrame") -> int:
    name = frame.format.name
    return int(name[-4:-2]) if name.endswith("le") else 8


class _Range(NamedTuple):
    """Which values of samples are black and white."""

    black: int
    steps: int  # From black to white
    color_steps: int  # From the least to the most of a color


def _range_of(frame: "VideoFrame") -> _Range:
    form, depth = _FORMATS[frame.format.name], _depth(frame)
    if frame.color_range == _FULL_RANGE or (form is not None and form.is_full):
        return _Range(0, (1 << depth) - 1, (1 << depth) - 1)
    return _Range(16 << depth - 8, 219 << depth - 8, 224 << depth - 8)


def _to_grey(frame: "VideoFrame") -> Pixels:
    import cv2

    if frame.format.name == "gbrp":
        return np.asarray(cv2.cvtColor(_to_bgr(frame), cv2.COLOR_BGR2GRAY), np.uint8)
    black, steps, _ = _range_of(frame)
    levels = (np.arange(1 << _depth(frame)) - black) * 255 / steps
    table = np.clip(np.floor(levels + 0.5), 0, 255).astype(np.uint8)
    (y, *_) = _planes(frame)
    return np.asarray(cv2.LUT(y, table) if y.dtype == np.uint8 else table[np.minimum(y, len(table) - 1)], np.uint8)


def _to_bgr(frame: "VideoFrame") -> Pixels:
    """Convert by ITU-T H.273, equations 38 to 40: the matrix and range that the video states, else BT.601 in limited
    range. A sample of color holds for all pixels that share it.
    """
    from fbench.replay.data.color_kernels import mix_colors

    form, planes = _FORMATS[frame.format.name], _planes(frame)
    if form is None:
        if len(planes) == 1:
            return np.repeat(_to_grey(frame)[:, :, None], 3, axis=2)
        green, blue, red = planes
        return np.stack([blue, green, red], axis=2).astype(np.uint8)
    y, cb, cr = (np.minimum(plane, (1 << form.depth) - 1) if form.depth > 8 else plane.copy() for plane in planes)
    out = np.empty((frame.height, 3 * frame.width), np.uint8)
    mix_colors(y, cb, cr, form.steps, _factors(frame, form.depth), out)
    return out.reshape(frame.height, frame.width, 3)


def _factors(frame: "VideoFrame", depth: int) -> NDArray[np.int32]:
    """Zeros and factors; see `mix_colors`."""
    from fbench.replay.data.color_kernels import BITS

    red, blue = _WEIGHTS.get(frame.colorspace, _BT601)
    black, steps, color_steps = _range_of(frame)
    green, of_blue, of_red = 1 - red - blue, 2 * (1 - blue) * 255 / color_steps, 2 * (1 - red) * 255 / color_steps
    parts = (255 / steps, of_red, -of_blue * blue / green, -of_red * red / green, of_blue)
    light, *colors = (round(part * (1 << BITS)) for part in parts)
    return np.array([black, light, 1 << depth - 1, *colors], np.int32)
