"""H.264: sizes, keyframes and the numbers of pictures (ITU-T H.264, 7.3 and 7.4)."""

from contextlib import suppress
from dataclasses import dataclass, replace

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.video.bits import (
    B_FRAMES,
    MAX_UNIT,
    Bits,
    MissingSetsError,
    PictureHead,
    Size,
    check_size,
    clear_numbers,
    is_back,
    join_units,
    unescape,
    units,
)

_SLICES, _IDR, _SEI, _SPS, _PPS = (1, 2, 5), 5, 6, 7, 8  # Types of units
_WITH_CHROMA = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)  # Profiles whose sets have more fields
_INTRA = 2  # Type of slices that need no other picture
_RECOVERY_POINT = 6  # Type of a message in a unit of supplemental information
_MAX_SETS = 256


@dataclass(frozen=True)
class _Sequence:
    """The part of a sequence parameter set that is needed."""

    size_wh: Size
    frame_num_bits: int
    has_gaps: bool  # Whether numbers of pictures may be left out on purpose
    order_bits: int  # Of the order in which pictures are shown; 0: not given as such
    has_planes: bool
    has_fields: bool
    delay_bits: tuple[tuple[int, int], ...] = ()  # Where it says how many pictures are reordered, unless that is 0


class H264Heads:
    """Reads the packets of one H.264 video; see `HeadReader`."""

    is_numbered = True

    def __init__(self) -> None:
        self._sequences: dict[int, tuple[_Sequence, bytes, bytes]] = {}  # With the unit, and one without delay
        self._pictures: dict[int, tuple[int, bytes]] = {}  # Number of the sequence, and the unit
        self._last_number: int | None = None  # Of the last picture that others refer to
        self._last_order = 0

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says about its picture; see `HeadReader`."""
        recovery: int | None = None
        has_sets = False
        for unit in units(packet):
            kind = unit[0] & 0x1F if unit else 0
            if kind in (_SPS, _PPS) and len(unit) <= MAX_UNIT:
                has_sets = has_sets or kind == _SPS
                self._take_set(kind, unit)
            elif kind == _SEI:
                recovery = _read_recovery(unescape(unit)) if recovery is None else recovery
            elif kind in _SLICES:
                return self._read_slice(unit, recovery, has_sets)
        return None

    def _take_set(self, kind: int, unit: bytes) -> None:
        bits = Bits(unescape(unit)[1:])
        if kind == _SPS:
            number, sequence = _read_sequence(bits)
            undelayed = clear_numbers(unit, 1, sequence.delay_bits) if sequence.delay_bits else unit
            self._sequences[number] = (sequence, unit, undelayed)
        else:
            number, of = bits.exp_golomb(), bits.exp_golomb()
            if number < _MAX_SETS:
                self._pictures[number] = (of, unit)

    def _read_slice(self, unit: bytes, recovery: int | None, has_sets: bool) -> PictureHead:
        is_key, is_reference = unit[0] & 0x1F == _IDR, bool(unit[0] & 0x60)
        bits = Bits(unescape(unit[:64])[1:])
        bits.exp_golomb()  # first macroblock
        is_intra = bits.exp_golomb() % 5 == _INTRA
        of, picture_set = self._pictures.get(bits.exp_golomb(), (-1, b""))
        if of not in self._sequences:
            raise MissingSetsError("video without the parameter sets that it needs")
        sequence, *sequence_sets = self._sequences[of]
        bits.skip(2 if sequence.has_planes else 0)
        number = bits.read(sequence.frame_num_bits)
        if sequence.has_fields and bits.read():
            bits.skip(1)  # which field
        if is_key:
            bits.exp_golomb()
        order = bits.read(sequence.order_bits)
        lost = "" if is_key else self._compare(sequence, number, order)
        self._last_order = order
        if is_key or is_reference:
            self._last_number = 0 if is_key else number
        sets = b"" if has_sets else join_units(sequence_sets[1], picture_set)
        undelayed = (sequence_sets[0], sequence_sets[1]) if has_sets else (b"", b"")
        # From a point of recovery in 0 pictures all are whole, as from a keyframe; some encoders claim that of others.
        recovers = recovery == 0 and is_intra
        recovery = None if recovery == 0 else recovery
        return PictureHead(sequence.size_wh, is_key or recovers, recovery, lost, sets, undelayed)

    def _compare(self, sequence: _Sequence, number: int, order: int) -> str:
        """Say why a picture doesn't follow the one before it: 7.4.3 on `frame_num`."""
        last, num = self._last_number, 1 << sequence.frame_num_bits
        if last is not None and number != (last + 1) % num and not sequence.has_gaps:
            return f"a message before it is missing: picture {number} comes after {last}"
        return B_FRAMES if sequence.order_bits and is_back(order, self._last_order, sequence.order_bits) else ""


def _read_sequence(bits: Bits) -> tuple[int, _Sequence]:
    """Read a sequence parameter set (7.3.2.1.1) as far as its size; return its number, too."""
    profile = bits.read(8)
    bits.skip(16)  # constraints and level
    number, chroma, has_planes = bits.exp_golomb(), 1, False
    if profile in _WITH_CHROMA:
        chroma = bits.exp_golomb()
        has_planes = chroma == 3 and bool(bits.read())
        bits.exp_golomb()  # depth of brightness
        bits.exp_golomb()  # depth of color
        bits.skip(1)
        if bits.read():
            _skip_scaling(bits, 8 if chroma != 3 else 12)
    frame_num_bits, order_bits = _few(bits.exp_golomb() + 4), 0
    order_type = bits.exp_golomb()
    if order_type == 0:
        order_bits = _few(bits.exp_golomb() + 4)
    elif order_type == 1:
        bits.skip(1)
        bits.signed_exp_golomb()
        bits.signed_exp_golomb()
        for _ in range(min(bits.exp_golomb(), 256)):
            bits.signed_exp_golomb()
    bits.exp_golomb()  # number of reference frames
    has_gaps = bool(bits.read())
    width, rows = 16 * (bits.exp_golomb() + 1), 16 * (bits.exp_golomb() + 1)
    has_fields = not bits.read()
    height = rows * (2 if has_fields else 1)
    bits.skip(2 if has_fields else 1)
    if bits.read():
        left, right, top, bottom = (bits.exp_golomb() for _ in range(4))
        across = 2 if chroma in (1, 2) and not has_planes else 1
        down = (2 if chroma == 1 else 1) * (2 if has_fields else 1)
        width, height = width - across * (left + right), height - down * (top + bottom)
    if number > 31:
        raise DecodeError("number of a parameter set of the video is too large")
    size_wh = check_size(width, height)
    sequence = _Sequence(size_wh, frame_num_bits, has_gaps, order_bits, has_planes, has_fields)
    with suppress(DecodeError):  # nothing else needs what follows
        sequence = replace(sequence, delay_bits=_find_delay(bits))
    return number, sequence


def _find_delay(bits: Bits) -> tuple[tuple[int, int], ...]:
    """Find `max_num_reorder_frames` (E.1.1), where it is there and not 0."""
    if not bits.read():
        return ()
    if bits.read() and bits.read(8) == 255:  # aspect ratio
        bits.skip(32)
    bits.skip(1 if bits.read() else 0)  # overscan
    if bits.read():  # kind of signal
        bits.skip(4)
        bits.skip(24 if bits.read() else 0)
    if bits.read():  # place of color
        bits.exp_golomb()
        bits.exp_golomb()
    bits.skip(65 if bits.read() else 0)  # timing
    has_buffers = [bool(bits.read()) and _skip_buffers(bits) for _ in range(2)]
    bits.skip(1 if any(has_buffers) else 0)
    bits.skip(1)
    if not bits.read():
        return ()
    bits.skip(1)
    for _ in range(4):
        bits.exp_golomb()
    start = bits.at
    is_delayed = bits.exp_golomb() > 0
    return ((start, bits.at),) if is_delayed else ()


def _skip_buffers(bits: Bits) -> bool:
    """Pass over the parameters of buffers: E.1.2."""
    num = bits.exp_golomb() + 1
    bits.skip(8)
    for _ in range(min(num, 32)):
        bits.exp_golomb()
        bits.exp_golomb()
        bits.skip(1)
    bits.skip(20)
    return True


def _few(num: int) -> int:
    if num > 16:
        raise DecodeError(f"numbers of {num} bits in a video, up to 16 are allowed")
    return num


def _skip_scaling(bits: Bits, num: int) -> None:
    """Pass over scaling lists: 7.3.2.1.1.1."""
    for i in range(num):
        if not bits.read():
            continue
        last = following = 8
        for _ in range(16 if i < 6 else 64):
            if following:
                following = (last + bits.signed_exp_golomb() + 256) % 256
            last = following or last


def _read_recovery(unit: bytes) -> int | None:
    """Read after how many pictures a decoder that begins here shows whole ones: D.1.8; `None` where it isn't said."""
    at = 1
    while at + 2 <= len(unit):
        values = []
        for _ in range(2):  # type and size of a message, each a sum of bytes that ends with one below 255
            value = 0
            while at < len(unit) and unit[at] == 0xFF:
                value, at = value + 255, at + 1
            if at == len(unit):
                return None
            value, at = value + unit[at], at + 1
            values.append(value)
        kind, size = values
        if kind == _RECOVERY_POINT and size:
            return Bits(unit[at : at + size]).exp_golomb()
        at += size
    return None
