"""Packets of Ouster sensors: points worked out by hand, and what the maker's own library makes of made-up packets."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.replay.logs.codecs.oracles.ouster_packets import (
    HEIGHT,
    PER_PACKET,
    PROFILES,
    START_NS,
    STEP_NS,
    WIDTH,
    metadata,
    packet,
    packets,
)  # fmt: skip

from fbench.replay.contracts.errors import DecodeError, UnsupportedError
from fbench.replay.logs.codecs.ouster import read_metadata

ORACLE = json.loads(Path(__file__).with_name("oracles").joinpath("ouster.json").read_text())
SINGLE = "RNG19_RFL8_SIG16_NIR16"


@pytest.mark.parametrize("key", ORACLE)
def test_points_are_those_of_the_makers_library(key):
    form, _, profile = key.rpartition(" ")
    sensor = read_metadata(metadata(profile, old=form == "old", up_mm=7.5 if form == "up" else 0.0))
    assert (sensor.packet_size, sensor.packets_per_turn) == (len(packets(profile)[0]), 4)
    turn = sensor.decode(packets(profile))
    column = np.rint(turn.time_ns / STEP_NS)
    assert (turn.start_ns, len(turn.xyz)) == (START_NS, ORACLE[key]["num"])
    for number, beam, *xyz, intensity in ORACLE[key]["rows"]:
        same = (column == number) & (turn.ring == beam) & (turn.intensity == intensity)
        assert np.linalg.norm(turn.xyz[same] - xyz, axis=1).min() < 1e-4


def test_every_profile_has_an_oracle():
    assert {key.rpartition(" ")[2] for key in ORACLE} == set(PROFILES)


def one_pixel(column: int, beam: int, range_mm: int, signal: int) -> bytes:
    words = np.zeros((PER_PACKET, HEIGHT, 3), np.uint32)
    words[column % PER_PACKET, beam] = [range_mm | 0xFF << 24, 9 | signal << 16, 77]
    return packet(SINGLE, 5, column // PER_PACKET * PER_PACKET, words)


def test_a_single_pixel():
    """Column 128 of 512 is a quarter turn clockwise; beams begin 15.8 mm from the axis."""
    turn = read_metadata(metadata(SINGLE)).decode([one_pixel(WIDTH // 4, 2, 10_015, 600)])
    azimuth, altitude = np.deg2rad(-90 + 1.4), np.deg2rad(20 - 2 * 40 / 15)
    flat = (10.015 - 0.0158) * np.cos(altitude)
    expected = [flat * np.cos(azimuth), flat * np.sin(azimuth) - 0.0158, (10.015 - 0.0158) * np.sin(altitude)]
    np.testing.assert_allclose(turn.xyz, [expected], atol=1e-3)
    assert (turn.intensity.tolist(), turn.ring.tolist(), turn.time_ns.tolist()) == ([600], [2], [0])
    assert turn.start_ns == START_NS + 128 * STEP_NS


def test_packets_of_functional_safety_have_the_pixels_of_the_other_two_returns():
    """In their head the number of the frame has 32 bits, and comes behind a type and the number of the start."""
    plain, name = "RNG15_RFL8_NIR8_DUAL", "FUSA_RNG15_RFL8_NIR8_DUAL"
    safe = [b"\1\7\0\0" + (70_005).to_bytes(4, "little") + data[8:] for data in packets(plain)]
    sensor = read_metadata(metadata(name))
    assert [sensor.frame_number(memoryview(data)) for data in safe] == [70_005 % 2**16] * 4
    turn, wanted = sensor.decode(safe), read_metadata(metadata(plain)).decode(packets(plain))
    np.testing.assert_array_equal(turn.xyz, wanted.xyz)
    np.testing.assert_array_equal(turn.intensity, wanted.intensity)


def test_invalid_columns_are_left_out():
    words = np.full((PER_PACKET, HEIGHT, 3), 5000, np.uint32)
    sensor = read_metadata(metadata(SINGLE))
    assert sensor.decode([packet(SINGLE, 1, 0, words, valid=0)]) is None
    turn = sensor.decode([packet(SINGLE, 1, 0, words, valid=0), packet(SINGLE, 1, 16, words)])
    assert len(turn.xyz) == PER_PACKET * HEIGHT
    beyond = packet(SINGLE, 1, WIDTH - 8, words)  # eight columns that a turn doesn't have
    assert len(sensor.decode([beyond]).xyz) == 8 * HEIGHT


def test_a_window_across_the_first_column():
    text = metadata(SINGLE).replace('"column_window": [0, 63]', '"column_window": [480, 31]')
    assert read_metadata(text).packets_per_turn == 4


def changed(**changes) -> str:
    tree = json.loads(metadata(SINGLE))
    for table in (tree["lidar_data_format"], tree["beam_intrinsics"]):
        table.update({key: value for key, value in changes.items() if key in table})
    return json.dumps(tree)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "not the metadata of an Ouster"),
        ("[]", "not the metadata of an Ouster"),
        ("[" * 100_000, "not the metadata of an Ouster"),
        ("1" * 1_000_001, "more than 1000000"),
        ("{}", "not the metadata of an Ouster"),
        (changed(beam_altitude_angles="high"), "not the metadata of an Ouster"),
        (changed(beam_altitude_angles=[1.0]), "numbers of columns and beams don't fit"),
        (changed(beam_azimuth_angles=[], beam_altitude_angles=[]), "numbers of columns and beams don't fit"),
        (changed(beam_azimuth_angles=[float("nan")] * HEIGHT), "angles that aren't finite"),
        (changed(columns_per_frame=-1), "numbers of columns and beams don't fit"),
        (changed(columns_per_frame=10**9), "numbers of columns and beams don't fit"),
        (changed(columns_per_packet=512, udp_profile_lidar="FIVE_WORD_PIXEL"), "packets that are too large"),
        (changed(column_window=[0, 512]), "numbers of columns and beams don't fit"),
        (changed(column_window=[0]), "not the metadata of an Ouster"),
    ],
)
def test_metadata_that_cant_be_used(text, why):
    with pytest.raises(DecodeError, match=why):
        read_metadata(text)


def test_another_profile_is_named():
    with pytest.raises(UnsupportedError, match="the profile 'FUTURE_PROFILE', which fbench doesn't read"):
        read_metadata(changed(udp_profile_lidar="FUTURE_PROFILE"))
