"""VP9 and AV1: sizes, keyframes, and in AV1 the order of pictures.

VP9 doesn't number its pictures, nor does AV1 without order hints, so that a lost message can't be told from the video
itself. Both come in the order in which they are shown.
"""

from collections.abc import Iterator
from typing import NamedTuple

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.video.bits import Bits, MissingSetsError, PictureHead, Size, check_size

_SYNC = 0x498342
_RGB = 7
_NO_SIZE = (0, 0)


class Vp9Heads:
    """Reads the packets of one VP9 video: section 6.2 of its specification; see `HeadReader`."""

    is_numbered = False

    def __init__(self) -> None:
        self._size_wh = _NO_SIZE

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says about its picture; see `HeadReader`."""
        bits = Bits(packet[:32])
        if bits.read(2) != 2:
            raise DecodeError("not a packet of VP9")
        profile = bits.read() | bits.read() << 1
        bits.skip(1 if profile == 3 else 0)
        is_repeat = bits.read()
        is_key = not is_repeat and not bits.read()
        if is_key:
            self._size_wh = _read_vp9_size(bits, profile)
        return PictureHead(self._size_wh, is_key)


def _read_vp9_size(bits: Bits, profile: int) -> Size:
    bits.skip(2)
    if bits.read(24) != _SYNC:
        raise DecodeError("keyframe of VP9 without its mark")
    bits.skip(1 if profile >= 2 else 0)  # depth
    is_rgb, has_sampling = bits.read(3) == _RGB, profile in (1, 3)
    if not is_rgb:
        bits.skip(1 + (3 if has_sampling else 0))  # range, and sampling of color
    elif has_sampling:
        bits.skip(1)
    return check_size(bits.read(16) + 1, bits.read(16) + 1)


_SEQUENCE, _FRAME_HEADER, _FRAME = 1, 3, 6  # Types of units (OBUs)
_KEY, _SWITCH = 0, 3  # Types of frames
_SELECT = 2  # A choice that each frame makes for itself
_MAX_UNITS = 512


class _Sequence(NamedTuple):
    """What a sequence header says (5.5), as far as headers of frames need it."""

    size_wh: Size
    is_still: bool
    time_bits: int  # Of the time of presentation; 0: frames have none
    id_bits: int  # Of the number of a frame; 0: frames have none
    screen_content: int
    integer_motion: int
    order_bits: int  # Of the order hint; 0: frames have none


class _Frame(NamedTuple):
    """What the header of a frame says (5.9)."""

    is_key: bool
    is_shown: bool
    order: int | None  # Its order hint; `None`: it has none, or shows a frame that came before


class Av1Heads:
    """Reads the packets of one AV1 video in low-overhead form: sections 5.3 to 5.9 of its specification; see
    `HeadReader`. A packet shows one picture, whose order hint is one more than that of the picture before it.
    """

    def __init__(self) -> None:
        self._sequence: _Sequence | None = None
        self._unit = b""  # That of the sequence header
        self._last: int | None = None  # Order of the last picture

    @property
    def is_numbered(self) -> bool:
        """Whether frames have order hints."""
        return self._sequence is not None and self._sequence.order_bits > 0

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says about its picture; see `HeadReader`."""
        has_sequence, first, shown = False, None, None
        for kind, whole, content in _units(packet):
            if kind == _SEQUENCE:
                self._sequence, self._unit, has_sequence = _read_sequence(Bits(content[:256])), whole, True
            elif kind in (_FRAME_HEADER, _FRAME):
                if self._sequence is None:
                    raise MissingSetsError("video without the sequence header that it needs")
                frame = _read_frame(Bits(content[:64]), self._sequence)
                first, shown = first or frame, shown or (frame if frame.is_shown else None)
        if first is None or self._sequence is None:
            return None
        lost = self._compare(first, shown, self._sequence.order_bits)
        missing = b"" if has_sequence else self._unit
        return PictureHead(self._sequence.size_wh, first.is_key, lost=lost, missing_sets=missing)

    def _compare(self, first: _Frame, shown: _Frame | None, order_bits: int) -> str:
        """Say why a picture doesn't follow the one before it, and remember its order."""
        last, num = self._last, 1 << order_bits
        if not order_bits or shown is None:
            return ""
        following = None if last is None else (last + 1) % num
        self._last = following if shown.order is None else shown.order
        if first.is_key or following is None or self._last == following:
            return ""
        return f"a message before it is missing: picture {self._last} comes after {last}"


def _read_frame(bits: Bits, sequence: _Sequence) -> _Frame:
    """Read the header of a frame (5.9.2) as far as its order hint."""
    if sequence.is_still:
        return _Frame(is_key=True, is_shown=True, order=None)
    if bits.read():  # shows a frame that came before
        return _Frame(is_key=False, is_shown=True, order=None)
    kind, is_shown = bits.read(2), bool(bits.read())
    bits.skip(sequence.time_bits if is_shown else 1)  # or whether it can be shown later
    if kind != _SWITCH and not (kind == _KEY and is_shown):
        bits.skip(1)  # resilience
    bits.skip(1)
    is_screen = bits.read() if sequence.screen_content == _SELECT else sequence.screen_content
    if is_screen and sequence.integer_motion == _SELECT:
        bits.skip(1)
    bits.skip(sequence.id_bits + (kind != _SWITCH))
    return _Frame(kind == _KEY, is_shown, bits.read(sequence.order_bits) if sequence.order_bits else None)


def _units(packet: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield type, whole unit and its content."""
    at = 0
    for _ in range(_MAX_UNITS):
        if at >= len(packet):
            return
        start, head = at, packet[at]
        if head & 0x80:
            raise DecodeError("not a packet of AV1")
        at += 2 if head & 4 else 1
        size = len(packet) - at
        if head & 2:
            size, shift = 0, 0
            while True:  # leb128
                if at >= len(packet) or shift > 28:
                    raise DecodeError("a unit of the video is cut off")
                byte, at = packet[at], at + 1
                size |= (byte & 0x7F) << shift
                shift += 7
                if byte < 0x80:
                    break
        if size < 0 or at + size > len(packet):
            raise DecodeError("a unit of the video is cut off")
        yield head >> 3 & 15, packet[start : at + size], packet[at : at + size]
        at += size
    raise DecodeError(f"video packet with over {_MAX_UNITS} units")


def _read_timing(bits: Bits) -> tuple[int, int]:
    """Read timing and the decoder's model (5.5.3 and 5.5.4). Return the bits of delays, 0 without a model, and of the
    time of presentation, 0 where frames have none.
    """
    bits.skip(64)
    is_even = bool(bits.read())
    if is_even:
        bits.exp_golomb()
    if not bits.read():
        return 0, 0
    delay_bits = bits.read(5) + 1
    bits.skip(32 + 5)
    time_bits = bits.read(5) + 1
    return delay_bits, 0 if is_even else time_bits


def _read_sequence(bits: Bits) -> _Sequence:
    """Read a sequence header (5.5.1)."""
    bits.skip(3 + 1)
    is_still, time_bits = bool(bits.read()), 0
    if is_still:
        bits.skip(5)
    else:
        delay_bits, time_bits = _read_timing(bits) if bits.read() else (0, 0)
        has_delay = bits.read()
        for _ in range(bits.read(5) + 1):
            bits.skip(12)
            bits.skip(1 if bits.read(5) > 7 else 0)
            if delay_bits and bits.read():
                bits.skip(2 * delay_bits + 1)
            if has_delay and bits.read():
                bits.skip(4)
    width_bits, height_bits = bits.read(4) + 1, bits.read(4) + 1
    size_wh = check_size(bits.read(width_bits) + 1, bits.read(height_bits) + 1)
    if is_still:
        return _Sequence(size_wh, is_still, time_bits, 0, _SELECT, _SELECT, 0)
    id_bits = 0
    if bits.read():  # frames have numbers
        id_bits = bits.read(4) + bits.read(3) + 3
    bits.skip(3 + 4)
    has_order = bits.read()
    bits.skip(2 if has_order else 0)
    screen_content = _SELECT if bits.read() else bits.read()
    integer_motion = _SELECT
    if screen_content and not bits.read():
        integer_motion = bits.read()
    order_bits = bits.read(3) + 1 if has_order else 0
    return _Sequence(size_wh, is_still, time_bits, id_bits, screen_content, integer_motion, order_bits)
