"""Headers of video packets, bit by bit, and the units of packets in Annex B form."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

from fbench.replay.contracts.errors import DecodeError

MAX_PIXELS = 35_651_584  # Of level 6.2 in H.264 and H.265; decoders hold up to 17 pictures
_START = b"\0\0\1"
_MAX_UNITS = 512  # Of a packet
_MAX_HEADER = 4096  # Bytes of a unit that are looked at; the longest parameter sets have some hundreds
MAX_UNIT = 64 * 1024  # Bytes of a parameter set
Size = tuple[int, int]


class PictureHead(NamedTuple):
    """What the headers of a packet say about its picture."""

    size_wh: Size
    is_key: bool  # Whether decoding can begin here
    recovery: int | None = None
    """Decoding can begin here, too, but pictures are whole only after so many more; `None`: it can't."""
    lost: str = ""  # Why it can't be decoded after the picture before it
    missing_sets: bytes = b""  # Parameter sets of earlier packets that a decoder needs where it begins here
    undelayed: tuple[bytes, bytes] = (b"", b"")
    """A parameter set of the packet, and what a decoder should get instead: see `clear_numbers`."""


class HeadReader(Protocol):
    """Reads the packets of one video in their order."""

    @property
    def is_numbered(self) -> bool:
        """Whether pictures have numbers, so that a lost one is missed, and equal packets are one picture twice."""

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says; `None` where it has no picture, only what later ones need. Raises DecodeError where
        it is damaged, or the picture is too large.
        """


class MissingSetsError(DecodeError):
    """A picture that needs parameter sets which didn't come yet."""


class Bits:
    """Reads numbers from the most significant bit on. All methods raise DecodeError where the data end early."""

    def __init__(self, data: bytes) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)
        self._num = self._left

    @property
    def at(self) -> int:
        """Bits that were read."""
        return self._num - self._left

    def read(self, num: int = 1) -> int:
        """Read an unsigned number of `num` bits."""
        self._left -= num
        if self._left < 0:
            raise DecodeError("a header of the video ends early")
        return (self._value >> self._left) & ((1 << num) - 1)

    def skip(self, num: int) -> None:
        """Pass over `num` bits."""
        self.read(num)

    def exp_golomb(self) -> int:
        """Read `ue(v)`: ITU-T H.264, 9.1."""
        zeros = 0
        while not self.read():
            zeros += 1
            if zeros > 31:
                raise DecodeError("a number in a header of the video is too large")
        return (1 << zeros) - 1 + self.read(zeros)

    def signed_exp_golomb(self) -> int:
        """Read `se(v)`: ITU-T H.264, 9.1.1."""
        code = self.exp_golomb()
        return (code + 1) // 2 if code % 2 else -(code // 2)


def units(packet: bytes) -> Iterator[bytes]:
    """Yield the units (NAL units) of a packet. Raises DecodeError where it isn't in Annex B form, or has too many."""
    start = packet.find(_START)
    if start < 0 or any(packet[:start]):
        raise DecodeError("video without start codes; fbench reads H.264 and H.265 in Annex B form")
    for _ in range(_MAX_UNITS):
        if start < 0:
            return
        begin = start + len(_START)
        start = packet.find(_START, begin)
        yield packet[begin : len(packet) if start < 0 else start]
    raise DecodeError(f"video packet with over {_MAX_UNITS} units")


def unescape(unit: bytes) -> bytes:
    """Return the beginning of a unit without the bytes that keep start codes out of it: H.264 and H.265, 7.4.1."""
    return unit[:_MAX_HEADER].replace(b"\0\0\3", b"\0\0")


def clear_numbers(unit: bytes, num_head: int, spans: Sequence[tuple[int, int]]) -> bytes:
    """Return a parameter set in which numbers in `ue(v)` are 0, given by their bits behind `num_head` bytes.

    Sets may announce B-frames that never come, and decoders then wait for later packets. Where pictures come in the
    order in which they are shown, no number of those to be reordered is wrong, and 0 makes them wait for none.
    """
    body = unescape(unit)[num_head:]
    bits = f"{int.from_bytes(body, 'big'):0{8 * len(body)}b}".rstrip("0")
    for start, end in reversed(spans):
        bits = f"{bits[:start]}1{bits[end:]}"
    bits += "0" * (-len(bits) % 8)
    plain = unit[:num_head] + int(bits, 2).to_bytes(len(bits) // 8, "big")
    return re.sub(rb"\0\0(?=[\0-\3])", b"\0\0\3", plain)


def join_units(*parts: bytes) -> bytes:
    """Return units as a packet, without the zeros that may follow them."""
    return b"".join(b"\0" + _START + part.rstrip(b"\0") for part in parts)


def check_size(width: int, height: int) -> Size:
    """Return a size [px]. Raises DecodeError where no picture can have it, or it is too large."""
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise DecodeError(f"video of {width}x{height} px, 1 to {MAX_PIXELS} px are read")
    return width, height


def is_back(value: int, before: int, num_bits: int) -> bool:
    """Tell whether a counter of `num_bits` went back, which it does where pictures come in another order than shown."""
    half = 1 << (num_bits - 1)
    return (value - before + half) % (2 * half) < half


B_FRAMES = "has B-frames: pictures come in another order than they are shown"
