"""VP9 and AV1: sizes and keyframes.

Neither numbers its pictures, so a lost message can't be told from the video itself. Both come in the order in which
they are shown.
"""

from collections.abc import Iterator

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.video.bits import Bits, MissingSetsError, PictureHead, Size, check_size

_SYNC = 0x498342
_RGB = 7
_NO_SIZE = (0, 0)


class Vp9Heads:
    """Reads the packets of one VP9 video: section 6.2 of its specification; see `HeadReader`."""

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
_MAX_UNITS = 512


class Av1Heads:
    """Reads the packets of one AV1 video in low-overhead form: sections 5.3 to 5.9 of its specification; see
    `HeadReader`.
    """

    def __init__(self) -> None:
        self._size_wh, self._sequence = _NO_SIZE, b""
        self._is_still = False

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says about its picture; see `HeadReader`."""
        has_sequence = False
        for kind, whole, content in _units(packet):
            if kind == _SEQUENCE:
                self._size_wh, self._is_still = _read_sequence(Bits(content[:256]))
                self._sequence, has_sequence = whole, True
            elif kind in (_FRAME_HEADER, _FRAME):
                if not self._sequence:
                    raise MissingSetsError("video without the sequence header that it needs")
                bits = Bits(content[:8])
                is_key = self._is_still or (not bits.read() and bits.read(2) == 0)
                return PictureHead(self._size_wh, is_key, missing_sets=b"" if has_sequence else self._sequence)
        return None


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


def _read_sequence(bits: Bits) -> tuple[Size, bool]:
    """Read a sequence header (5.5.1) as far as its size; and whether it is that of a still picture."""
    bits.skip(3 + 1)
    is_still = bool(bits.read())
    if is_still:
        bits.skip(5)
    else:
        has_model, delay_bits = False, 0
        if bits.read():  # timing
            bits.skip(64)
            if bits.read():
                bits.exp_golomb()
            has_model = bool(bits.read())
            if has_model:
                delay_bits = bits.read(5) + 1
                bits.skip(32 + 5 + 5)
        has_delay = bits.read()
        for _ in range(bits.read(5) + 1):
            bits.skip(12)
            bits.skip(1 if bits.read(5) > 7 else 0)
            if has_model and bits.read():
                bits.skip(2 * delay_bits + 1)
            if has_delay and bits.read():
                bits.skip(4)
    width_bits, height_bits = bits.read(4) + 1, bits.read(4) + 1
    return check_size(bits.read(width_bits) + 1, bits.read(height_bits) + 1), is_still
