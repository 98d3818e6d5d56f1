"""Lidar packets of Ouster sensors to points, as the firmware user manual describes packets and the sensor's metadata.

A packet holds some columns, each with a time and one pixel of every beam; the columns of a turn have one frame number.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import DecodeError, UnsupportedError
from fbench.replay.data.arrays import Array, Float32, Float64, Int64

_MAX_METADATA = 1_000_000  # Characters; a sensor's has 20,000
_MAX_COLUMNS, _MAX_PIXELS = 8192, 512
_MAX_PACKET = 65_535


class _Field(NamedTuple):
    """A number within the 32-bit words of a pixel."""

    word: int
    shift: int
    bits: int
    up: int = 0  # Lower bits that were cut off

    def read(self, words: Array) -> Array:
        """Take it from words (..., W)."""
        return ((words[..., self.word] >> np.uint32(self.shift)) & np.uint32((1 << self.bits) - 1)) << np.uint32(
            self.up
        )


class _Return(NamedTuple):
    range_mm: _Field
    intensity: _Field  # Signal where the profile has it, else reflectivity


class _Profile(NamedTuple):
    num_words: int
    returns: tuple[_Return, ...]


_LEGACY, _FUSA = "LEGACY", "FUSA_RNG15_RFL8_NIR8_DUAL"
_FRAME_AT: Mapping[str, int] = {_LEGACY: 10, _FUSA: 4}  # Byte of a packet at which the number of its frame is, else 2
_RANGE1, _RANGE2 = _Field(0, 0, 19), _Field(1, 0, 19)
_LOW1, _LOW2 = _Return(_Field(0, 0, 15, 3), _Field(0, 16, 8)), _Return(_Field(1, 0, 15, 3), _Field(1, 16, 8))
_ONE = _Return(_RANGE1, _Field(1, 16, 16))
_TWO = (_Return(_RANGE1, _Field(2, 0, 16)), _Return(_RANGE2, _Field(2, 16, 16)))
_PROFILES: Mapping[str, _Profile] = {
    _LEGACY: _Profile(3, (_Return(_Field(0, 0, 20), _Field(1, 16, 16)),)),
    "RNG19_RFL8_SIG16_NIR16": _Profile(3, (_ONE,)),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": _Profile(3, (_ONE,)),
    "RNG19_RFL8_SIG16_NIR16_RGB16": _Profile(4, (_Return(_RANGE1, _Field(1, 0, 16)),)),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(4, _TWO),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": _Profile(4, _TWO),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": _Profile(5, _TWO),
    "FIVE_WORD_PIXEL": _Profile(5, _TWO),
    "RNG15_RFL8_NIR8": _Profile(1, (_LOW1,)),
    "RNG15_RFL8_WIN8": _Profile(1, (_LOW1,)),
    "RNG15_RFL8_NIR8_ZONE16": _Profile(2, (_LOW1,)),
    "RNG15_RFL8_NIR8_DUAL": _Profile(2, (_LOW1, _LOW2)),
    _FUSA: _Profile(2, (_LOW1, _LOW2)),
}
_ORIGINS_MM = (("OS-0-", 27.67), ("OS-1-", 15.806), ("OS-2-", 13.762), ("", 12.163))
"""From the sensor's axis to where beams begin, by product, for old firmware that doesn't say it."""


class Turn(NamedTuple):
    """The points of one turn, in the lidar coordinate frame of the sensor."""

    start_ns: int  # Time of its first column, by the sensor's clock
    xyz: Float32  # (N, 3)
    intensity: Float32
    ring: Array  # (N,) uint16, 0 at the top
    time_ns: Int64  # (N,) after `start_ns`


@dataclass(frozen=True, eq=False)
class OusterFormat:
    """What a sensor's metadata say about its packets and beams."""

    profile: str
    columns_per_frame: int
    columns_per_packet: int
    window: tuple[int, int]  # First and last column that is sent; across 0 where the first one is larger
    altitude_rad: Float64  # (H,) of beams
    azimuth_rad: Float64  # (H,) to be added to that of the column, to the left
    origin_m: tuple[float, float]  # Of beams: from the axis outwards, and up

    @property
    def packet_size(self) -> int:
        """Bytes of a packet."""
        return self._columns_at[0] + self._columns.itemsize * self.columns_per_packet + self._columns_at[1]

    @property
    def packets_per_turn(self) -> int:
        """Packets that hold the columns of the window."""
        first, last = (column // self.columns_per_packet for column in self.window)
        per_frame = -(-self.columns_per_frame // self.columns_per_packet)
        return last - first + 1 if self.window[0] <= self.window[1] else per_frame - first + last + 1

    def frame_number(self, packet: memoryview) -> int:
        """Number of the turn that a packet belongs to, modulo 65,536."""
        at = _FRAME_AT.get(self.profile, 2)
        return int.from_bytes(packet[at : at + 2], "little")

    def decode(self, packets: Sequence[bytes]) -> Turn | None:
        """Return the points of the packets of one turn, column by column; `None` where no column is valid."""
        start, end = self._columns_at[0], self.packet_size - self._columns_at[1]
        data = b"".join(packet[start:end] for packet in packets)
        table = np.frombuffer(data, self._columns)
        table = table[(table["status"] & 1 == 1) & (table["column"] < self.columns_per_frame)]
        if not len(table):
            return None
        times = table["time"].astype(np.int64)
        start_ns = int(times.min())
        words = np.ascontiguousarray(table["pixels"])
        found = [self._points(table["column"], part, words) for part in _PROFILES[self.profile].returns]
        xyz, intensity, row, beam = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return Turn(start_ns, xyz, intensity, beam.astype(np.uint16), times[row] - start_ns)

    def _points(self, columns: Array, part: _Return, words: Array) -> tuple[Array, Array, Array, Array]:
        """Points, intensities, numbers of the row of their column, and of their beams."""
        distance = part.range_mm.read(words)
        row, beam = np.divmod(np.flatnonzero(distance), distance.shape[1])
        encoder = -2 * np.pi * columns.astype(np.float64) / self.columns_per_frame
        out, up = self.origin_m
        far = distance[row, beam] * 1e-3 - np.hypot(out, up)
        turn = (encoder[row] + self.azimuth_rad[beam]).astype(np.float32)  # NumPy's cosine is faster with these
        flat, xyz = far * np.cos(self.altitude_rad)[beam], np.empty((len(row), 3), np.float32)
        xyz[:, 0] = flat * np.cos(turn) + (out * np.cos(encoder))[row]
        xyz[:, 1] = flat * np.sin(turn) + (out * np.sin(encoder))[row]
        xyz[:, 2] = far * np.sin(self.altitude_rad)[beam] + up
        return xyz, part.intensity.read(words)[row, beam].astype(np.float32), row, beam

    @property
    def _columns_at(self) -> tuple[int, int]:
        """Bytes before and after the columns."""
        return (0, 0) if self.profile == _LEGACY else (32, 32)

    @cached_property
    def _columns(self) -> np.dtype[Any]:
        pixels = ("pixels", "<u4", (len(self.altitude_rad), _PROFILES[self.profile].num_words))
        if self.profile == _LEGACY:
            head = [("time", "<u8"), ("column", "<u2"), ("frame", "<u2"), ("encoder", "<u4")]
            return np.dtype([*head, pixels, ("status", "<u4")])
        return np.dtype([("time", "<u8"), ("column", "<u2"), ("status", "<u2"), pixels])


def read_metadata(text: str) -> OusterFormat:
    """Read the metadata of a sensor, in the form of old or new firmware. Raises DecodeError where they aren't complete,
    UnsupportedError where the packets have a form that isn't read.
    """
    if len(text) > _MAX_METADATA:
        raise DecodeError(f"metadata of {len(text)} characters, more than {_MAX_METADATA}")
    try:
        tree = json.loads(text)
        beams, data, info = (
            _table(tree, *names)
            for names in (("beam_intrinsics",), ("lidar_data_format", "data_format"), ("sensor_info",))
        )
        config = _table(tree, "config_params")
        found = _format(beams or tree, data, str((info or tree).get("prod_line", "")), config or tree)
    except (ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError) as error:
        raise DecodeError(f"not the metadata of an Ouster sensor ({error})") from error
    _check(found)
    return found


def _table(tree: Mapping[str, Any], *names: str) -> Mapping[str, Any]:
    return next((tree[name] for name in names if name in tree), {})


def _format(beams: Mapping[str, Any], data: Mapping[str, Any], product: str, config: Mapping[str, Any]) -> OusterFormat:
    angles = [np.array(beams[f"beam_{name}_angles"], np.float64).reshape(-1) for name in ("altitude", "azimuth")]
    num_columns = int(data.get("columns_per_frame") or str(config["lidar_mode"]).partition("x")[0])
    first, last = data.get("column_window") or (0, num_columns - 1)
    out_mm = beams.get("lidar_origin_to_beam_origin_mm")
    if out_mm is None:
        out_mm = next(mm for start, mm in _ORIGINS_MM if product.startswith(start))
    matrix = np.array(beams.get("beam_to_lidar_transform") or np.eye(4), np.float64).reshape(4, 4)
    out_mm, up_mm = (matrix[0, 3], matrix[2, 3]) if matrix[:3, 3].any() else (float(out_mm), 0.0)
    return OusterFormat(
        str(data.get("udp_profile_lidar") or _LEGACY) + ("" if data.get("header_type") != "FUSA" else " (FUSA)"),
        num_columns, int(data.get("columns_per_packet") or 16), (int(first), int(last)), np.deg2rad(angles[0]),
        -np.deg2rad(angles[1]), (float(out_mm) / 1000, float(up_mm) / 1000),
    )  # fmt: skip


def _check(found: OusterFormat) -> None:
    if found.profile not in _PROFILES:
        raise UnsupportedError(f"its packets have the profile '{found.profile[:60]}', which fbench doesn't read")
    num, per_packet = found.columns_per_frame, found.columns_per_packet
    are_good = 0 < num <= _MAX_COLUMNS and 0 < per_packet <= num and all(0 <= c < num for c in found.window)
    beams = (
        np.stack([found.altitude_rad, found.azimuth_rad]) if len(found.altitude_rad) == len(found.azimuth_rad) else None
    )
    if not are_good or beams is None or not 0 < beams.shape[1] <= _MAX_PIXELS:
        raise DecodeError("metadata of an Ouster sensor whose numbers of columns and beams don't fit together")
    if not (np.isfinite(beams).all() and np.isfinite(found.origin_m).all() and found.packet_size <= _MAX_PACKET):
        raise DecodeError("metadata of an Ouster sensor with angles that aren't finite, or packets that are too large")
