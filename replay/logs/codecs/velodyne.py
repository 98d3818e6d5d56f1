"""Packets of Velodyne LiDARs to points: VLP-16, Puck Hi-Res, VLP-32C, HDL-32E, VLS-128 (Alpha Prime).

After the user manuals: VLP-16 63-9243, VLP-32C 63-9325, HDL-32E 63-9113, VLS-128 63-9483. A packet has 12 blocks of 32
shots; its last two bytes tell the mode of return and the model. Lasers fire one after the other while the sensor turns,
so each shot has a time and an azimuth of its own.
"""

from typing import NamedTuple

import numpy as np

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.logs.codecs.velodyne_lasers import LASERS, Lasers

SIZE = 1206
_SHOT = np.dtype([("distance", "<u2"), ("intensity", "u1")])
_BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("shots", _SHOT, (32,))])
_PACKET = np.dtype([("blocks", _BLOCK, (12,)), ("stamp_us", "<u4"), ("mode", "u1"), ("model", "u1")])
_FIRST, _SECOND = 0xEEFF, 0xDDFF
_BANKS = (_FIRST, _SECOND, 0xCCFF, 0xBBFF)  # Flags of the blocks with lasers 0 to 31, 32 to 63, 64 to 95, 96 to 127
_DUAL = 0x39
_HDL32E, _VLS128 = 0x21, 0xA1
_HOUR_US = 3_600_000_000
_TURN = 36_000  # Of azimuths, in 0.01 deg


class Points(NamedTuple):
    """The returns of some packets, in the order of blocks and shots."""

    xyz: Float32  # (N, 3) x forward, at azimuth 0, y left, z up
    intensity: Float32
    ring: Array  # (N,) uint16, 0 at the bottom
    time_ns: Float64  # (N,) after the stamp of the packet
    packet: Int64  # (N,) number of the packet


class _Shots(NamedTuple):
    """When shots fire, and which laser each is."""

    laser: Array  # (N,)
    time_ns: Float64  # (N,) after the stamp of the packet
    since_ns: Float64  # (N,) after the instant to which the azimuth of the block belongs
    rate: Float64  # (P,) of the azimuth, by packet [0.01 deg / ns]


def find_model(packets: Array) -> int:
    """Return the factory byte of the sensor that sent packets (P, 1206). Old firmware of HDL-32E doesn't set it. Raises
    UnsupportedError where it is a sensor that can't be decoded.
    """
    table = _table(packets)
    values, counts = np.unique(table["model"], return_counts=True)
    most = int(values[np.argmax(counts)]) if len(values) else 0
    if 2 * counts.max(initial=0) >= len(table) and most in LASERS:
        return most
    flags = table["blocks"]["flag"]
    if not np.isin(flags, (_FIRST, _SECOND)).all() or not len(table):
        raise UnsupportedError(f"packets are of no Velodyne that fbench can decode (model 0x{most:02x})")
    if (flags == _SECOND).any():
        raise UnsupportedError("packets of an HDL-64E can't be decoded without the calibration of its lasers")
    return _HDL32E


def decode(packets: Array) -> Points:
    """Return the points of packets (P, 1206) of one sensor in the order of time. Raises UnsupportedError as
    `find_model`.
    """
    model, table = find_model(packets), _table(packets)
    lasers, blocks = LASERS[model], table["blocks"]
    is_known = table["model"] == model
    dual = is_known & (table["mode"] == _DUAL)
    is_good = np.isin(blocks["flag"], _BANKS if model == _VLS128 else _BANKS[:1])
    is_good &= (is_known.any() <= is_known)[:, None]  # of a sensor that sets the byte, no other packets
    distance = np.ascontiguousarray(blocks["shots"]["distance"])
    hit = (distance > 0) & is_good[:, :, None]
    if dual.any():  # where the last return is the strongest one as well, both say the same: the second one counts
        is_same = (distance[:, 0::2] == distance[:, 1::2]) & hit[:, 1::2]
        hit[:, 0::2] &= ~(dual[:, None, None] & is_same)
    flat = np.flatnonzero(hit)
    row, shot = flat // 32, flat % 32  # of the block among all, and within it
    packet = row // 12
    shots = _fire_vls128(table, dual, row, shot) if model == _VLS128 else _fire(table, dual, row, shot, lasers)
    azimuth = blocks["azimuth"].ravel()[row] + shots.rate[packet] * shots.since_ns
    xyz = _place(distance.ravel()[flat] * lasers.resolution_m, np.deg2rad(azimuth / 100), shots.laser, lasers)
    intensity = np.ascontiguousarray(blocks["shots"]["intensity"]).ravel()[flat].astype(np.float32)
    return Points(xyz, intensity, lasers.ring[shots.laser], shots.time_ns, packet)


def clock_ns(packets: Array) -> Int64:
    """Return when packets (P, 1206) were measured, counted from the last one, by the sensor's own clock."""
    stamp_us = _table(packets)["stamp_us"].astype(np.int64)
    half = _HOUR_US // 2
    return ((stamp_us - stamp_us[-1:] + half) % _HOUR_US - half) * 1000


def _table(packets: Array) -> Array:
    return np.ascontiguousarray(packets).view(_PACKET).reshape(-1)


def _place(distance: Float64, azimuth: Float64, laser: Array, lasers: Lasers) -> Float32:
    """Points (N, 3) of distances along lasers; azimuth turns clockwise as seen from above."""
    azimuth = (azimuth + lasers.azimuth_rad[laser]).astype(np.float32)  # NumPy's cosine is ten times as fast with these
    flat = distance * lasers.cos_elevation[laser]
    xyz = np.empty((len(distance), 3), np.float32)
    xyz[:, 0], xyz[:, 1] = flat * np.cos(azimuth), -flat * np.sin(azimuth)
    xyz[:, 2] = distance * lasers.sin_elevation[laser] + lasers.height_m[laser]
    return xyz


def _fire(table: Array, dual: Bool, row: Int64, shot: Int64, lasers: Lasers) -> _Shots:
    """Timing of the sensors with up to 32 lasers. In dual mode two blocks hold the returns of the same shots."""
    num = len(lasers.ring)
    blocks, shots = np.arange(12)[:, None], np.arange(32)[None, :]
    sequence = blocks * (32 // num) + shots // num
    fire_ns = lasers.cycle_ns * sequence + lasers.step_ns * (shots % num // lasers.at_once)  # (12, 32)
    which = np.where(dual[:, None], np.arange(12) // 2, np.arange(12)).ravel()[row]
    azimuth = table["blocks"]["azimuth"].astype(np.int64)
    rate = (azimuth[:, 11] - azimuth[:, 0]) % _TURN / np.where(dual, fire_ns[5, 0], fire_ns[11, 0])
    at = which * 32 + shot
    return _Shots(shot % num, fire_ns.ravel()[at], (fire_ns - fire_ns[:, :1]).ravel()[at], rate)


_CHANNELS_NS = 2_665.0, 2_890.0
"""Between the firings of eight lasers each: of firmware up to 5.1.7, and of later one."""
_PACKET_US = 167  # Three sequences of 20 firings take 160 us with the first of these, 173 us with the second


def _fire_vls128(table: Array, dual: Bool, row: Int64, shot: Int64) -> _Shots:
    """Timing of a VLS-128: four blocks hold one sequence of all lasers, in dual mode eight do. Its packets are stamped
    at the fourth firing.
    """
    flags, azimuth = table["blocks"]["flag"], table["blocks"]["azimuth"].astype(np.int64)
    bank = sum((flags == flag) * i for i, flag in enumerate(_BANKS))
    laser = (bank * 32).ravel()[row] + shot
    steps_us = np.diff(table["stamp_us"].astype(np.int64)) * np.where(dual[1:], 3, 1)
    step_us = float(np.median(steps_us)) if len(steps_us) else 0.0
    channel_ns = _CHANNELS_NS[0] if 0 < step_us < _PACKET_US else _CHANNELS_NS[1]
    lasers = np.arange(128)
    since_ns = ((lasers // 8 + lasers // 64 * 2) * channel_ns)[laser]
    column = np.where(dual[:, None], 0, np.arange(12) // 4)
    time_ns = since_ns + ((20 * column - 3) * channel_ns).ravel()[row]
    within = (azimuth[:, 8] - azimuth[:, 0]) % _TURN / (40 * channel_ns)
    steps = np.diff(azimuth[:, 0]) % _TURN
    between = float(np.median(steps)) / (20 * channel_ns) if len(steps) else 0.0  # the sensor turns evenly
    return _Shots(laser, time_ns, since_ns, np.where(dual, between, within))
