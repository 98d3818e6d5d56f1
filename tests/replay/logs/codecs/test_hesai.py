"""Packets of Hesai sensors, written byte by byte as the manuals lay them out, and points worked out by hand."""

import struct

import numpy as np
import pytest

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.logs.codecs.hesai import clock_ns, decode, read_table

STRONGEST, DUAL = 0x37, 0x39


def packet(shots=(), num=32, mode=STRONGEST, stamp_us=0, azimuth=9_000, step=18, unit_mm=4, number=b"\1\0\0\0"):
    """One packet; `shots` are (block, laser, distance in steps, reflectivity)."""
    head = b"\xee\xff\6\1\0\0" + bytes([num, 8, 0, unit_mm, 1, 0])
    body = b""
    for block in range(8):
        row = [(0, 0)] * num
        for at, laser, distance, reflectivity in shots:
            if at == block:
                row[laser] = distance, reflectivity
        turned = azimuth + step * (block // 2 if mode == DUAL else block)
        body += struct.pack("<H", turned) + b"".join(struct.pack("<HBB", *shot, 0) for shot in row)
    utc = bytes([123, 11, 14, 22, 13, 20])
    return head + body + bytes(10) + struct.pack("<BH6sIB", mode, 600, utc, stamp_us, 0x42) + number


def test_sizes_are_those_of_the_manuals():
    assert (len(packet()), len(packet(num=16))) == (1080, 568)


def test_a_single_shot_of_an_xt32():
    """Laser 5 of block 6, 10 m away at 10 deg up and 90 + 6 * 0.18 deg from y: one block, 50 us, before the last."""
    points = decode(read_table([packet([(6, 5, 2_500, 77)])]))
    azimuth, up = np.deg2rad(91.08), np.deg2rad(10)
    flat = 10 * np.cos(up)
    np.testing.assert_allclose(
        points.xyz, [[flat * np.sin(azimuth), flat * np.cos(azimuth), 10 * np.sin(up)]], atol=1e-4
    )
    assert points.time_ns.tolist() == [5_632 - 50_000 + 368 + 5 * 1_512]
    assert (points.ring.tolist(), points.intensity.tolist(), points.packet.tolist()) == ([26], [77], [0])


@pytest.mark.parametrize(("num", "lowest_deg", "second_deg"), [(32, -16, 14), (16, -15, 13)])
def test_lasers_are_in_order_from_the_top(num, lowest_deg, second_deg):
    points = decode(read_table([packet([(7, 0, 1_000, 1), (7, 1, 1_000, 2), (7, num - 1, 1_000, 3)], num)]))
    elevation = np.rad2deg(np.arcsin(points.xyz[:, 2] / 4))
    np.testing.assert_allclose(elevation, [15, second_deg, lowest_deg], atol=1e-3)
    assert points.ring.tolist() == [num - 1, num - 2, 0]


def test_equal_returns_of_dual_mode_are_one_point():
    """Both blocks of a pair are at one time and azimuth."""
    shots = [(4, 0, 1_000, 1), (5, 0, 1_000, 2), (6, 0, 1_000, 3), (7, 0, 2_000, 4)]
    points = decode(read_table([packet(shots, mode=DUAL)]))
    assert points.intensity.tolist() == [2, 3, 4]
    assert points.time_ns.tolist() == [-44_000, 6_000, 6_000]
    np.testing.assert_allclose(points.xyz[2], 2 * points.xyz[1], rtol=1e-5)


def test_the_clock_of_the_sensor_goes_on_over_a_second():
    table = read_table([packet(stamp_us=us) for us in (999_900, 300, 700)])
    assert clock_ns(table).tolist() == [0, 400_000, 800_000]


def test_what_is_no_packet_of_theirs():
    good = packet([(0, 0, 1, 1)])
    assert len(read_table([b"", good[:100], good, good[:1076], b"x" * 1080])) == 2
    for packets in ([], [good[:1000]], [b"\xee\xff" + bytes(1078)], [packet(num=64)]):
        with pytest.raises(UnsupportedError, match="of Hesai's only PandarXT-32 and XT-16"):
            read_table(packets)
