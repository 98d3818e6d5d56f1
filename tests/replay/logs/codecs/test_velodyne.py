"""Packets of Velodynes: points worked out by hand, and what another decoder makes of made-up packets."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.replay.logs.codecs.oracles.velodyne_packets import DUAL, MODELS, STRONGEST, empty, packets

from fbench.replay.contracts.errors import UnsupportedError
from fbench.replay.logs.codecs.velodyne import SIZE, clock_ns, decode, find_model

ORACLE = json.loads(Path(__file__).with_name("oracles").joinpath("velodyne.json").read_text())
TOLERANCE_S = 2e-6  # It stamps packets of a VLS-128 7 us before their first shot, the manual three firings of 2.89 us
ROUNDING = np.deg2rad(0.011)  # It rounds azimuths to 0.01 deg


def as_bytes(table: np.ndarray) -> np.ndarray:
    return table.view(np.uint8).reshape(len(table), SIZE)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("mode", [STRONGEST, DUAL])
def test_points_are_those_of_another_decoder(name, mode):
    expected, data = ORACLE[f"{name} {mode:#x}"], packets(MODELS[name], mode)
    points = decode(data)
    start_ns = clock_ns(data) - clock_ns(data)[0]
    time_s = (points.time_ns + start_ns[points.packet]) / 1e9
    assert len(points.xyz) == expected["num"]
    assert len(expected["rows"]) >= 10
    for at_s, ring, *xyz, intensity in expected["rows"]:
        same = (points.ring == ring) & (points.intensity == intensity) & (np.abs(time_s - at_s) < TOLERANCE_S)
        distances = np.linalg.norm(points.xyz[same] - xyz, axis=1)
        assert distances.min() < 5e-4 + ROUNDING * np.linalg.norm(xyz)


def test_a_single_shot_of_a_vlp16():
    """Laser 1 (1 deg up) of the second firing of block 2, 10 m away: 5 * 55.296 us + 2.304 us after the stamp, while
    the sensor turns by 0.2 deg from block to block.
    """
    table = empty(0x22)
    table["blocks"]["azimuth"] = 8_000 + 20 * np.arange(12)
    table["blocks"]["shots"]["distance"][0, 2, 17] = 5_000
    table["blocks"]["shots"]["intensity"][0, 2, 17] = 99
    points = decode(as_bytes(table))
    azimuth = np.deg2rad(80.4 + 0.2 * (55.296 + 2.304) / 110.592)
    flat = 10 * np.cos(np.deg2rad(1))
    expected = [flat * np.cos(azimuth), -flat * np.sin(azimuth), 10 * np.sin(np.deg2rad(1)) - 0.0007]
    np.testing.assert_allclose(points.xyz, [expected], atol=1e-4)
    assert points.time_ns.tolist() == pytest.approx([5 * 55_296 + 2_304])
    assert (points.ring.tolist(), points.intensity.tolist(), points.packet.tolist()) == ([8], [99], [0])


def test_two_returns_at_one_distance_are_one_point():
    table = empty(0x22, DUAL)
    table["blocks"]["shots"]["distance"][0, :4, 0] = [1_000, 1_000, 2_000, 3_000]
    table["blocks"]["shots"]["intensity"][0, :4, 0] = [1, 2, 3, 4]
    points = decode(as_bytes(table))
    assert points.intensity.tolist() == [2, 3, 4]
    np.testing.assert_allclose(np.linalg.norm(points.xyz, axis=1), [2, 4, 6], atol=0.02)
    assert np.diff(points.time_ns).tolist() == pytest.approx([2 * 55_296, 0])


def test_a_block_with_an_unknown_flag_is_left_out():
    data = packets(0x28, STRONGEST, num=1)
    whole = decode(data)
    data[0, 500:502] = 0
    part = decode(data)
    assert 0 < len(part.xyz) < len(whole.xyz)
    assert set(map(tuple, part.xyz)) < set(map(tuple, whole.xyz))


def test_packets_of_another_sensor_are_left_out():
    mixed = np.concatenate([packets(0x22, STRONGEST, num=3), packets(0x21, STRONGEST, num=1)])
    assert find_model(mixed) == 0x22
    assert set(decode(mixed).packet) == {0, 1, 2}


def test_old_firmware_of_an_hdl32e():
    """It sends parts of its status in the last two bytes."""
    table = packets(0x21, STRONGEST).copy()
    new = decode(table)
    table[:, 1204:] = [[86, 1], [86, 2], [87, 3], [88, 4]]
    np.testing.assert_array_equal(decode(table).xyz, new.xyz)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"model": 0x31}, "no Velodyne that fbench can decode"),
        ({"model": 0, "flags": 0xDDFF}, "HDL-64E can't be decoded without the calibration of its lasers"),
    ],
)
def test_other_sensors_are_refused(change, text):
    table = empty(change["model"])
    table["blocks"]["flag"][:, 1::2] = change.get("flags", 0x1234)
    with pytest.raises(UnsupportedError, match=text):
        decode(as_bytes(table))


def test_any_bytes_are_points_or_an_error():
    rng = np.random.Generator(np.random.Philox(5))
    for model in MODELS.values():
        data = rng.integers(0, 256, (3, SIZE)).astype(np.uint8)
        data[:, 1205] = model
        data[:, 0:1200:100], data[:, 1:1200:100] = 0xFF, 0xEE
        points = decode(data)
        assert np.isfinite(points.xyz).all()
        assert len(points.xyz) > 700


def test_the_sensors_clock_begins_again_each_hour():
    table = empty(0x22, num=3)
    table["stamp_us"] = [3_599_999_000, 3_599_999_900, 400]
    assert clock_ns(as_bytes(table)).tolist() == [-1_400_000, -500_000, 0]
