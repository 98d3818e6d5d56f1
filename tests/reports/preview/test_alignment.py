"""Edges of depth and brightness tell whether a camera is turned."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.reports.preview.street import SIZE, K, Street, gray, sample, street_rig

from fbench.replay.data.rig import Mount, Rig
from fbench.reports.preview.alignment import align
from fbench.reports.preview.sample import depth_edges, level_edges


def turned(yaw_deg, axis="z"):
    """The rig with its LiDAR's extrinsics turned to the left, or about another axis of the body."""
    rig = street_rig()
    mount = Mount("lidar", np.zeros(3), Rotation.from_euler(axis, yaw_deg, degrees=True).as_quat())
    return Rig({**rig.mounts, "lidar": mount}, rig.cameras)


def first_hit(blocks, y, z):
    """Distance in x (N,) of what rays (1, y, z) hit first: blocks (x, y, half width, top) before a wall at 40 m."""
    depth = np.full(y.shape, 40.0)
    for x, at, half, top in sorted(blocks, reverse=True):
        depth[(np.abs(y * x - at) < half) & (z * x < top)] = x
    return depth


def skyline_samples(rig, num=4):
    """Frames with blocks of different heights all over the image, seen by a LiDAR of rings half a degree apart."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    steps = np.radians(np.arange(-40, 40, 0.25)), np.radians(np.arange(-20, 20, 0.5))
    azimuth, altitude = (grid.ravel() for grid in np.meshgrid(*steps))
    y, z = np.tan(azimuth), np.tan(altitude) / np.cos(azimuth)
    found = []
    for i in range(num):
        random = np.random.Generator(np.random.Philox(i))
        blocks = [(x, x * random.uniform(-0.7, 0.7), x / 25, x * random.uniform(-0.2, 0.3)) for x in range(8, 24)]
        shade = first_hit(blocks, (K[0, 2] - u) / K[0, 0], (K[1, 2] - v) / K[1, 1])
        pixels = np.where(shade < 40, 30 + shade * 7 % 80, 210).astype(np.uint8)
        x = first_hit(blocks, y, z)
        cloud = np.stack([x, x * y, x * z], axis=1).astype(np.float32)
        found.append(sample(rig, i, clouds={"lidar": cloud}, images={"cam": np.repeat(pixels[:, :, None], 3, axis=2)}))
    return found


def street_samples(rig):
    """Frames with poles at different places."""
    streets = [Street(tuple((x, y + shift) for x, y in Street().poles)) for shift in (0.0, 0.7, -0.6, 1.3, -1.1, 0.35)]
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


def test_upper_edges_lie_between_the_rings():
    """A block 10 m ahead up to 5.2 degrees, a wall 20 m ahead; rings are a degree apart."""
    altitude = np.radians(np.arange(-10, 11))
    distance = np.where(altitude < np.radians(5.2), 10.0, 20.0)
    edges = level_edges(np.stack([distance * np.cos(altitude), 0 * altitude, distance * np.sin(altitude)], axis=1))
    assert np.degrees(np.arctan2(edges[:, 2], edges[:, 0])) == pytest.approx([5.5])
    assert np.hypot(edges[:, 0], edges[:, 2]) == pytest.approx([10.0])


def test_rings_on_the_ground_are_no_edges():
    altitude = np.radians(np.arange(-20, -3.0))
    distance = 1.8 / np.sin(-altitude)
    ground = np.stack([distance * np.cos(altitude), 0 * altitude, distance * np.sin(altitude)], axis=1)
    assert len(level_edges(ground)) == len(level_edges(np.zeros((0, 3)))) == 0


def test_an_axis_is_vouched_for_only_where_an_error_would_be_seen():
    """Poles without upper ends tell of yaw alone; blocks of different heights tell of all axes."""
    pitch, yaw, roll = align(street_samples(street_rig()), "cam").noticed_deg
    assert yaw is not None
    assert pitch is roll is None
    found = align(skyline_samples(street_rig()), "cam")
    assert not found.is_bad
    assert all(deg is not None and deg <= 2 for deg in found.noticed_deg), found.noticed_deg
    assert "pitch within" in found.verdict
    assert "can't be judged" not in found.verdict


@pytest.mark.parametrize(("axis", "camera_axis", "sign"), [("x", 2, -1), ("y", 0, 1), ("z", 1, 1)])
def test_a_turn_about_any_axis_is_found(axis, camera_axis, sign):
    """The body's x, y and z axes are the camera's z, -x and -y: the mend is the opposite turn about these."""
    found = align(skyline_samples(turned(3.0, axis)), "cam")
    assert found.is_off
    assert found.turn_deg[camera_axis] == pytest.approx(sign * 3.0, abs=0.5)


def test_poles_say_nothing_of_a_rolled_camera():
    found = align(street_samples(turned(2.0, "x")), "cam")
    assert not found.is_bad
    assert "roll can't be judged" in found.verdict or "pitch and roll can't be judged" in found.verdict


def test_swapped_axes_fit_nowhere():
    rig = turned(90)
    assert align(street_samples(rig), "cam").is_bad or "too few" in align(street_samples(rig), "cam").verdict


def test_without_edges_nothing_is_said():
    seen = sample(street_rig(), clouds={"lidar": [[10.0, 0, 0]]}, images={"cam": gray()})
    found = align([seen, replace(seen, rig=Rig({}, {}))], "cam")
    assert not found.is_bad
    assert "too few LiDAR edges" in found.verdict
    assert "too few" in align([], "cam").verdict
