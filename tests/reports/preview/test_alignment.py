"""Edges of depth and brightness tell whether a camera is turned."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.reports.preview.street import Street, gray, sample, street_rig

from fbench.replay.data.rig import Mount, Rig
from fbench.reports.preview.alignment import align
from fbench.reports.preview.sample import depth_edges


def turned(yaw_deg):
    """The rig with its LiDAR's extrinsics turned to the left."""
    rig = street_rig()
    mount = Mount("lidar", np.zeros(3), Rotation.from_euler("z", yaw_deg, degrees=True).as_quat())
    return Rig({**rig.mounts, "lidar": mount}, rig.cameras)


def street_samples(rig):
    """Three frames with poles at different places."""
    streets = [Street(tuple((x, y + shift) for x, y in Street().poles)) for shift in (0.0, 0.7, -0.6)]
    return [sample(rig, i, clouds={"lidar": s.cloud()}, images={"cam": s.image()}) for i, s in enumerate(streets)]


def test_the_near_side_of_a_jump_is_an_edge():
    azimuth = np.radians(np.arange(-5, 5, 0.2))
    distance = np.where(np.abs(azimuth) < np.radians(1.05), 10.0, 20.0)
    xyz = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), 0 * azimuth], axis=1)
    edges = depth_edges(xyz)
    assert set(np.round(np.hypot(*xyz[edges, :2].T))) == {10.0}
    assert len(edges)
    assert len(depth_edges(xyz[:5])) == 0
    assert len(depth_edges(np.zeros((0, 3)))) == 0


def test_jumps_are_found_between_shots_a_degree_apart():
    """As in a turn of 50,000 shots over 128 channels, where no ring has its shots above those of another."""
    shot = np.arange(50_000)
    ring = shot % 128
    azimuth, altitude = np.pi - shot * (2 * np.pi / len(shot)), np.radians(30 - ring * 50 / 127)
    is_pole = np.abs(azimuth) < np.radians(3)
    distance = np.where(is_pole, 10.0, 20.0)
    xyz = np.stack([np.cos(altitude) * np.cos(azimuth), np.cos(altitude) * np.sin(azimuth), np.sin(altitude)], axis=1)
    edges = depth_edges(distance[:, None] * xyz)
    assert is_pole[edges].all()
    beside = np.degrees(np.abs(azimuth[edges]))
    assert beside.min() > 3 - 2 * 0.93
    sides = {(int(ring[i]), azimuth[i] > 0) for i in edges}
    assert len(sides) == 2 * 128


def test_a_right_calibration_fits():
    found = align(street_samples(street_rig()), "cam")
    assert not found.is_bad
    assert found.score > 1.3
    assert "fit the image as calibrated" in found.verdict


@pytest.mark.parametrize("yaw", [2.0, -2.5, 3.0])
def test_a_turned_lidar_is_told_by_how_much(yaw):
    """Turning to the left is turning about the camera's y axis, which points down, by the negative angle; the mend is
    the opposite.
    """
    found = align(street_samples(turned(yaw)), "cam")
    assert found.is_off
    assert found.turn_deg[1] == pytest.approx(yaw, abs=0.5)
    assert f"{found.turn_deg[1]:+.1f} deg about the camera's y axis" in found.verdict


def test_swapped_axes_fit_nowhere():
    rig = turned(90)
    assert align(street_samples(rig), "cam").is_bad or "too few" in align(street_samples(rig), "cam").verdict


def test_without_edges_nothing_is_said():
    seen = sample(street_rig(), clouds={"lidar": [[10.0, 0, 0]]}, images={"cam": gray()})
    found = align([seen, replace(seen, rig=Rig({}, {}))], "cam")
    assert not found.is_bad
    assert "too few LiDAR edges" in found.verdict
    assert "too few" in align([], "cam").verdict
