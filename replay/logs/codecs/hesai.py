"""Packets of Hesai LiDARs to points: PandarXT-32 and PandarXT-16.

After the user manuals of both (header, eight blocks of one return of all lasers, tail), the nominal angles and firing
times of which Hesai's HesaiLidar_General_SDK (pandarXT.h) and TIER IV's nebula (pandar_xt32.hpp, PandarXT16.csv) give
alike: lasers are one degree apart from 15 deg down to -16 deg, with an XT-16 every second one, all at the azimuth of
their block. A single sensor deviates by up to 0.1 deg from that, as the calibration says that it can be asked for.
"""

from collections.abc import Sequence

import numpy as np

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.logs.codecs.velodyne import Points

_NUM_BLOCKS = 8
_SHOT = np.dtype([("distance", "<u2"), ("reflectivity", "u1"), ("confidence", "u1")])
_MARK = b"\xee\xff"
_DUAL = (0x39, 0x3B, 0x3C)  # Modes in which two blocks hold the returns of the same shots
_LASERS = {32: 1, 16: 2}  # Degrees from one laser to the next, by their number
_TOP_DEG = 15
_BLOCK_NS, _FIRST_NS = 50_000, 5_632 + 368
"""Between blocks, and from the packet's stamp to the first shot of its last block [ns]."""
_STEP_NS = 1_512  # From one laser of an XT-32 to the next; an XT-16 leaves every second one out
_SECOND_US = 1_000_000


def _layout(num: int) -> np.dtype[np.void]:
    block = np.dtype([("azimuth", "<u2"), ("shots", _SHOT, (num,))])
    head = [("mark", "S2"), ("version", "u1", (2,)), ("reserved", "u1", (2,)), ("num_lasers", "u1"),
            ("num_blocks", "u1"), ("first_return", "u1"), ("unit_mm", "u1"), ("num_returns", "u1"),
            ("flags", "u1")]  # fmt: skip
    tail = [("more", "u1", (10,)), ("mode", "u1"), ("speed_rpm", "<u2"), ("utc", "u1", (6,)), ("stamp_us", "<u4"),
            ("factory", "u1")]  # fmt: skip
    return np.dtype([*head, ("blocks", block, (_NUM_BLOCKS,)), *tail])


_LAYOUTS = {num: _layout(num) for num in _LASERS}


def read_table(packets: Sequence[bytes]) -> Array:
    """Return the packets of one sensor as structures (P,); those of another form are left out. A number may follow
    behind a packet. Raises UnsupportedError where none is of a sensor that can be decoded.
    """
    for num, layout in _LAYOUTS.items():
        head = _MARK, num, _NUM_BLOCKS
        own = [p[: layout.itemsize] for p in packets if len(p) >= layout.itemsize and (p[:2], p[6], p[7]) == head]
        if own:
            return np.frombuffer(b"".join(own), layout)
    raise UnsupportedError("packets are of no LiDAR that fbench can decode, of Hesai's only PandarXT-32 and XT-16")


def decode(table: Array) -> Points:
    """Return the points of packets (P,), in the order of packets, blocks and lasers. As the driver has it, y is forward
    at azimuth 0, x right, z up; azimuth turns clockwise as seen from above. In dual mode equal returns are one point.
    """
    blocks = table["blocks"]
    distance, num = blocks["shots"]["distance"], blocks["shots"].shape[2]
    is_dual = np.isin(table["mode"], _DUAL)
    hit = distance > 0
    hit[:, 0::2] &= ~(is_dual[:, None, None] & (distance[:, 0::2] == distance[:, 1::2]))
    packet, block, laser = np.nonzero(hit)
    range_m = distance[hit] * (table["unit_mm"][packet] / 1000.0)
    azimuth, elevation = (
        np.deg2rad(blocks["azimuth"][packet, block] / 100.0),
        np.deg2rad(_TOP_DEG - _LASERS[num] * laser),
    )
    flat = range_m * np.cos(elevation)
    xyz = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), range_m * np.sin(elevation)], axis=1)
    before = np.where(is_dual[packet], (_NUM_BLOCKS - 1 - block) // 2, _NUM_BLOCKS - 1 - block)
    time_ns = (_FIRST_NS - _BLOCK_NS * before + _STEP_NS * _LASERS[num] * laser).astype(np.float64)
    intensity = blocks["shots"]["reflectivity"][hit].astype(np.float32)
    return Points(xyz.astype(np.float32), intensity, (num - 1 - laser).astype(np.uint16), time_ns, packet)


def clock_ns(table: Array) -> Int64:
    """Return when packets (P,) were sent, counted from the first one, by the sensor's own clock."""
    stamp_us, half = table["stamp_us"].astype(np.int64), _SECOND_US // 2
    return ((stamp_us - stamp_us[:1] + half) % _SECOND_US - half) * 1000
