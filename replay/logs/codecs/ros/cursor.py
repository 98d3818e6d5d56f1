"""Reading of ROS messages field by field."""

import struct
from typing import Any, Literal, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Array, Float32

CDR, ROS1 = "cdr", "ros1"

_ENCAPSULATION = 4
_SLACK = 3  # Writers may fill a CDR payload up to a multiple of 4 bytes


class Header(NamedTuple):
    """`std_msgs/Header`; stamp 0 means that none was given."""

    stamp_ns: int
    frame_id: str


class Cursor:
    """Position in a payload. CDR aligns each number to its size, counted from the end of the encapsulation. Lengths are
    checked against the payload before anything is allocated. All methods raise DecodeError where the payload ends
    early.
    """

    def __init__(self, data: memoryview, encoding: str) -> None:
        self._data, self._cdr, self._at = data, encoding == CDR, 0
        self._order: Literal["<", ">"] = "<"
        if self._cdr:
            kind = bytes(data[:2])
            if len(data) < _ENCAPSULATION or kind not in (b"\0\0", b"\0\1"):
                raise DecodeError(f"CDR encapsulation 0x{kind.hex()} isn't supported, only plain CDR (0x0000, 0x0001)")
            self._data, self._order = data[_ENCAPSULATION:], "<" if kind[1] else ">"

    def uint8(self) -> int:
        """Read one byte."""
        return self._take(1)[0]

    def uint32(self) -> int:
        """Read a uint32."""
        return int(self._number("I"))

    def uint64(self) -> int:
        """Read a uint64."""
        return int(self._number("Q"))

    def float32(self) -> float:
        """Read a float32."""
        return float(self._number("f"))

    def floats(self) -> Float32:
        """Read a sequence of float32 (N,): a view."""
        num = self.uint32()
        return np.frombuffer(self._take(4 * num), f"{self._order}f4").astype(np.float32, copy=False)

    def rows(self, dtype: np.dtype[Any], num: int) -> Array:
        """Read `num` structures: a view. CDR aligns each to the alignment of its largest number, 4 bytes at most, but
        fills nothing up after the last one.
        """
        rows = np.dtype(dtype).newbyteorder(self._order)
        if not self._cdr:
            return np.frombuffer(self._take(num * rows.itemsize), rows)
        self._align(4)
        step = -(-rows.itemsize // 4) * 4
        data = self._take(num * step - (step - rows.itemsize) if num else 0)
        return np.ndarray((num,), rows, data, strides=(step,))

    def string(self) -> str:
        """Read a string; in CDR a zero ends it, except that some writers give an empty one the length 0."""
        length = self.uint32()
        raw = bytes(self._take(length))
        if self._cdr and length:
            if raw[-1]:
                raise DecodeError("a string doesn't end with a zero")
            raw = raw[:-1]
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise DecodeError(f"a string isn't UTF-8 ({error})") from error

    def blob(self) -> memoryview:
        """Read a sequence of bytes: a view."""
        return self._take(self.uint32())

    def header(self) -> Header:
        """Read a `std_msgs/Header`."""
        if not self._cdr:
            self.uint32()  # seq
        sec = self._number("i" if self._cdr else "I")
        return Header(nanoseconds(sec, self.uint32()), plain_frame(self.string()))

    def end(self) -> None:
        """Check that nothing follows."""
        rest = len(self._data) - self._at
        if rest > (_SLACK if self._cdr else 0):
            raise DecodeError(f"{rest} bytes are left over at its end")

    def _number(self, form: str) -> Any:
        size = struct.calcsize(f"={form}")
        self._align(size)
        return struct.unpack(self._order + form, self._take(size))[0]

    def _align(self, size: int) -> None:
        if self._cdr:
            self._at = -(-self._at // size) * size

    def _take(self, size: int) -> memoryview:
        end = self._at + size
        if end > len(self._data):
            raise DecodeError(f"payload ends early: {size} bytes expected at {self._at} of {len(self._data)}")
        part = self._data[self._at : end]
        self._at = end
        return part


def nanoseconds(sec: int, nanosec: int) -> int:
    """Return a ROS time in ns. Raises DecodeError where it isn't between 1970 and what an int64 holds."""
    if not (isinstance(sec, int) and isinstance(nanosec, int)):  # a log may define a time of texts
        raise DecodeError("a stamp isn't of whole numbers")
    stamp_ns = sec * 1_000_000_000 + nanosec
    if sec < 0 or not 0 <= stamp_ns < 2**63:
        raise DecodeError(f"stamp of {sec} s {nanosec} ns is out of range")
    return stamp_ns


def plain_frame(frame_id: str) -> str:
    """Return the name of a coordinate frame as tf2 has it: tf of ROS 1 began names with a slash."""
    return frame_id.removeprefix("/")
