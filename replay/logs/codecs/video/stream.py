"""Video in a log: each message gets its place among those that it is decoded after, or the reason why it has none."""

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, TypeVar

from fbench.replay.contracts.errors import DecodeError, MissingPackageError, UnsupportedError
from fbench.replay.data.messages import Image
from fbench.replay.data.video import MAX_STRETCH_BYTES, Decoder, Stretch, VideoPicture
from fbench.replay.logs.codecs.video.bits import B_FRAMES, MAX_UNIT, HeadReader, MissingSetsError, PictureHead
from fbench.replay.logs.codecs.video.h264 import H264Heads
from fbench.replay.logs.codecs.video.h265 import H265Heads
from fbench.replay.logs.codecs.video.vp9_av1 import Av1Heads, Vp9Heads

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

_HEADS: Mapping[str, Callable[[], HeadReader]] = {
    "h264": H264Heads, "h265": H265Heads, "vp9": Vp9Heads, "av1": Av1Heads,
}  # fmt: skip
_NAMES: Mapping[str, str] = {
    "h264": "h264", "x264": "h264", "openh264": "h264", "avc": "h264", "avc1": "h264", "h265": "h265", "x265": "h265",
    "hevc": "h265", "hvc1": "h265", "hev1": "h265", "vp9": "vp9", "vpx-vp9": "vp9", "vp09": "vp9", "av1": "av1",
    "av01": "av1", "aom-av1": "av1", "svtav1": "av1", "rav1e": "av1",
}  # fmt: skip
"""Forms of video by the names that writers give them, among them those of FFmpeg's encoders."""
BEFORE_KEY = "before the first keyframe"
_REBUILT = "still being built after a point of recovery"


def find_codec(name: str) -> str | None:
    """Return the form of video that a writer means: `h264` for `libx264`, `h264_nvenc` or `h264;yuv420p;bgr8`."""
    word = re.split(r"[;/, ]", name.strip().lower())[0].removeprefix("lib").replace("h.26", "h26")
    return _NAMES.get(word) or _NAMES.get(word.split("_")[0])


def require_codec(name: str) -> str:
    """Return the form of video that a writer means. Raises UnsupportedError for any other."""
    codec = find_codec(name)
    if codec is None:
        raise UnsupportedError(f"video in '{name[:40]}' isn't supported, only {', '.join(_HEADS)}")
    return codec


def peek_size(codec: str, packet: bytes) -> tuple[int, int]:
    """Return the size [px] that a packet says by itself, as keyframes do; zeros where it doesn't."""
    with suppress(DecodeError):
        if (head := _HEADS[codec]().read(packet)) is not None:
            return head.size_wh
    return 0, 0


class _Ready:
    """One picture that was decoded when it was read."""

    def __init__(self, frame: "VideoFrame | None", error: MissingPackageError | None = None) -> None:
        self._frame, self._error = frame, error

    def frame(self, index: int) -> "VideoFrame | None":
        if self._error is not None:
            raise self._error
        return self._frame


class VideoStream:
    """Takes the messages of one camera in the order in which they were recorded."""

    def __init__(self) -> None:
        self._codec = ""
        self._heads: HeadReader | None = None
        self._stretch: Stretch | None = None
        self._whole_from = 0
        self._why, self._is_lost = BEFORE_KEY, False  # Why there is no picture while there is no stretch
        self._waiting = b""  # Parameter sets that came in a message of their own
        self._last: Image | None = None
        self._decoder: Decoder | None = None
        self._error: MissingPackageError | None = None

    @property
    def is_numbered(self) -> bool:
        """Whether a lost message is missed."""
        return self._heads is not None and self._heads.is_numbered

    def take(self, image: Image) -> Image | None:
        """Return a message with its place in the video and its size; `None` where it holds no picture, only what the
        next one needs, and then gets.
        """
        last = self._last
        if last is not None and last.data == image.data and self.is_numbered and image.encoding == self._codec:
            return replace(image, size_wh=last.size_wh, video=last.video)
        if image.encoding != self._codec or self._heads is None:
            self._codec, self._heads, self._stretch = image.encoding, _HEADS[image.encoding](), None
        packet = self._waiting + image.data
        self._waiting = b""
        try:
            head = self._heads.read(packet)
        except DecodeError as error:
            # Before the first keyframe nothing can be lost.
            if self._stretch is not None or not isinstance(error, MissingSetsError):
                self._break_off(str(error))
            return replace(image, video=VideoPicture(None, 0, self._why, self._is_lost))
        if head is None:
            self._waiting = packet if len(packet) <= MAX_UNIT else b""
            return None
        self._last = replace(image, data=packet, size_wh=head.size_wh, video=self._place(packet, head))
        return self._last

    def _break_off(self, why: str) -> None:
        self._stretch, self._decoder, self._why, self._is_lost = None, None, why, True

    def _place(self, packet: bytes, head: PictureHead) -> VideoPicture:
        if head.lost and self._stretch is not None:
            self._break_off(head.lost)
        if head.is_key or (self._stretch is None and head.recovery is not None):
            self._whole_from = 0 if head.is_key else head.recovery or 0
            self._stretch, self._decoder = Stretch(self._codec, head.size_wh, self._whole_from), None
            self._error = None
        if self._stretch is None:
            return VideoPicture(None, 0, self._why, self._is_lost)
        given, undelayed = head.undelayed
        packet = packet if given == undelayed else packet.replace(given, undelayed)
        packet = head.missing_sets + packet if self._stretch.num_bytes == 0 else packet
        if self._stretch.num_bytes > MAX_STRETCH_BYTES:
            return VideoPicture(self._decode_now(self._stretch, packet))
        index = self._stretch.add(packet)
        return VideoPicture(self._stretch, index, _REBUILT if index < self._whole_from else "", self._is_lost)

    def _decode_now(self, stretch: Stretch, packet: bytes) -> _Ready:
        """Decode a picture so far from its keyframe that not all packets between are kept."""
        if self._error is None and self._decoder is None:
            try:
                self._decoder = Decoder(stretch.codec, stretch.size_wh)
            except MissingPackageError as error:  # who only reads doesn't need it
                self._error = error
            else:
                for earlier in stretch.packets:
                    self._decoder.decode(earlier)
        frame = None if self._decoder is None else self._decoder.decode(packet)
        if frame is None and self._error is None:
            self._break_off("can't be decoded")
        return _Ready(frame, self._error)


class VideoStreams:
    """The videos of a log, by topic."""

    def __init__(self) -> None:
        self._streams: dict[str, VideoStream] = {}

    def take(self, topic: str, image: Image) -> Image | None:
        """Place a message; see `VideoStream`. What is no video comes back as it is."""
        if image.encoding not in _HEADS:
            return image
        return self._streams.setdefault(topic, VideoStream()).take(image)

    def is_numbered(self, topic: str) -> bool:
        """Tell whether a lost message of a topic is missed: always, where it is no video."""
        return topic not in self._streams or self._streams[topic].is_numbered


T = TypeVar("T")


class VideoLead(Generic[T]):
    """What is needed of one video before a point in time: its messages from the last keyframe on. None, where they
    would be larger than `MAX_STRETCH_BYTES`.
    """

    def __init__(self) -> None:
        self.items: list[T] = []
        self._heads: tuple[str, HeadReader] | None = None
        self._num_sets = 0  # Messages at the end that hold parameter sets alone
        self._with_sets: list[T] = []  # The last keyframe that came with its parameter sets
        self._num_bytes = 0
        self._is_open = False  # Whether there was a keyframe

    def add(self, item: T, image: Image) -> None:
        """Take the next message, given as a whole and as what it holds."""
        if self._heads is None or self._heads[0] != image.encoding:
            self._heads = image.encoding, _HEADS[image.encoding]()
        head = None
        with suppress(DecodeError):
            head = self._heads[1].read(image.data)
            self._num_sets += head is None
        if head is not None:
            if head.is_key:
                sets = self.items[len(self.items) - self._num_sets :]
                if head.missing_sets and not sets:
                    self.items = list(self._with_sets)
                else:
                    self.items, self._with_sets = sets, [*sets, item]
                self._num_bytes, self._is_open = 0, True
            self._num_sets = 0
        if self._is_open or self._num_sets:
            self.items.append(item)
            self._num_bytes += len(image.data)
        if self._num_bytes > MAX_STRETCH_BYTES:
            self.items, self._num_bytes, self._is_open = [], 0, False


_NUM_PROBED = 8  # Pictures after a keyframe, among which encoders that use B-frames put some


class OrderProbe:
    """Refuses a video with B-frames by its first pictures."""

    def __init__(self) -> None:
        self._stream, self._num_left = VideoStream(), _NUM_PROBED

    def is_done(self, image: Image) -> bool:
        """Take the next message; tell whether enough were seen. Raises UnsupportedError at a B-frame."""
        found = self._stream.take(image)
        if found is None or found.video is None:
            return False
        if found.video.damage == B_FRAMES:
            what = f"its video {B_FRAMES}; encode it without (-bf 0)"
            raise UnsupportedError(what)
        self._num_left -= not found.video.damage
        return self._num_left <= 0
