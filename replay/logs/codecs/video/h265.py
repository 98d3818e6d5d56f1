"""H.265: sizes, keyframes and the order of pictures (ITU-T H.265, 7.3 and 7.4).

Which earlier pictures a picture needs isn't read here: unlike for H.264, decoders refuse one that lacks any.
"""

from typing import NamedTuple

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

_PICTURES = range(32)  # Types of units that hold a picture
_KEYS = range(16, 24)  # Types of those with which decoding can begin
_IDR = (19, 20)
_VPS, _SPS, _PPS = 32, 33, 34


class _Sequence(NamedTuple):
    size_wh: Size
    order_bits: int
    has_planes: bool
    video: int  # Number of its video parameter set
    delay_bits: tuple[tuple[int, int], ...]  # Where it says how many pictures are reordered, unless that is 0


class _Picture(NamedTuple):
    of: int  # Number of its sequence parameter set
    has_output_flag: bool
    num_extra_bits: int


class H265Heads:
    """Reads the packets of one H.265 video; see `HeadReader`."""

    is_numbered = True

    def __init__(self) -> None:
        self._sequences: dict[int, _Sequence] = {}
        self._pictures: dict[int, _Picture] = {}
        self._units: dict[tuple[int, int], bytes] = {}
        self._undelayed: dict[int, tuple[bytes, bytes]] = {}  # Unit of a sequence, and one without delay
        self._last_order: int | None = None

    def read(self, packet: bytes) -> PictureHead | None:
        """Tell what a packet says about its picture; see `HeadReader`."""
        has_sets = False
        for unit in units(packet):
            if len(unit) < 3:
                continue
            kind = unit[0] >> 1 & 0x3F
            if kind in (_VPS, _SPS, _PPS) and len(unit) <= MAX_UNIT:
                has_sets = has_sets or kind == _SPS
                self._take_set(kind, unit)
            elif kind in _PICTURES:
                return self._read_slice(kind, unit, has_sets)
        return None

    def _take_set(self, kind: int, unit: bytes) -> None:
        bits = Bits(unescape(unit)[2:])
        if kind == _VPS:
            number = bits.read(4)
        elif kind == _SPS:
            number, sequence = _read_sequence(bits)
            self._sequences[number] = sequence
            undelayed = clear_numbers(unit, 2, sequence.delay_bits) if sequence.delay_bits else unit
            self._undelayed[number] = (unit, undelayed)
            unit = undelayed
        else:
            number, of = bits.exp_golomb(), bits.exp_golomb()
            bits.skip(1)
            has_output_flag = bool(bits.read())
            if number > 63:
                raise DecodeError("number of a parameter set of the video is too large")
            self._pictures[number] = _Picture(of, has_output_flag, bits.read(3))
        self._units[kind, number] = unit

    def _read_slice(self, kind: int, unit: bytes, has_sets: bool) -> PictureHead:
        bits = Bits(unescape(unit[:64])[2:])
        is_key = kind in _KEYS
        is_first = bits.read()
        if is_key:
            bits.skip(1)
        number = bits.exp_golomb()
        picture = self._pictures.get(number)
        if picture is None or picture.of not in self._sequences:
            raise MissingSetsError("video without the parameter sets that it needs")
        if not is_first:
            raise DecodeError("video packet that doesn't begin with a picture's first slice")
        sequence, order = self._sequences[picture.of], 0
        if kind not in _IDR:
            bits.skip(picture.num_extra_bits)
            bits.exp_golomb()  # type of the slice
            bits.skip((1 if picture.has_output_flag else 0) + (2 if sequence.has_planes else 0))
            order = bits.read(sequence.order_bits)
        last, self._last_order = self._last_order, order
        is_reordered = not is_key and last is not None and is_back(order, last, sequence.order_bits)
        wanted = ((_VPS, sequence.video), (_SPS, picture.of), (_PPS, number))
        sets = b"" if has_sets else join_units(*(self._units[key] for key in wanted if key in self._units))
        lost, undelayed = B_FRAMES if is_reordered else "", (b"", b"")
        if has_sets:
            undelayed = self._undelayed[picture.of]
        return PictureHead(sequence.size_wh, is_key, None, lost, sets, undelayed)


def _read_sequence(bits: Bits) -> tuple[int, _Sequence]:
    """Read a sequence parameter set (7.3.2.2.1) as far as the bits of the order; return its number, too."""
    video, num_sub_layers = bits.read(4), bits.read(3)
    bits.skip(1 + 88 + 8)  # general profile and level: 7.3.3
    given = [(bits.read(), bits.read()) for _ in range(num_sub_layers)]
    bits.skip(2 * (8 - num_sub_layers) if num_sub_layers else 0)
    for has_profile, has_level in given:
        bits.skip(88 * has_profile + 8 * has_level)
    number, chroma = bits.exp_golomb(), bits.exp_golomb()
    has_planes = chroma == 3 and bool(bits.read())
    width, height = bits.exp_golomb(), bits.exp_golomb()
    if bits.read():
        left, right, top, bottom = (bits.exp_golomb() for _ in range(4))
        across, down = (2 if chroma in (1, 2) else 1), (2 if chroma == 1 else 1)
        width, height = width - across * (left + right), height - down * (top + bottom)
    bits.exp_golomb()  # depth of brightness
    bits.exp_golomb()  # depth of color
    order_bits = bits.exp_golomb() + 4
    if order_bits > 16 or number > 15:
        raise DecodeError("a number in a header of the video is too large")
    spans = _find_delays(bits, num_sub_layers)
    return number, _Sequence(check_size(width, height), order_bits, has_planes, video, spans)


def _find_delays(bits: Bits, num_sub_layers: int) -> tuple[tuple[int, int], ...]:
    """Find `sps_max_num_reorder_pics` of all layers in time, where it isn't 0."""
    spans = []
    for _ in range(1 + (num_sub_layers if bits.read() else 0)):
        bits.exp_golomb()
        start = bits.at
        if bits.exp_golomb():
            spans.append((start, bits.at))
        bits.exp_golomb()
    return tuple(spans)
