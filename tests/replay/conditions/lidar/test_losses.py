"""What LiDARs lose: counts are exact, beams stay dead, shadows lie where the wall is."""

import numpy as np
import pytest
from tests.replay.conditions.sites import QUARTER_LEFT, bytes_of, cloud, disturb, street

from fbench.replay.conditions.lidar.losses import BeamDrop, Cutout, Density, FieldOfView, IncompleteEcho, Occluder
from fbench.replay.data.boxes import Boxes3D

LOSSES = [BeamDrop(), Cutout(), Density(), FieldOfView(), Occluder()]


@pytest.mark.parametrize("condition", LOSSES, ids=lambda c: type(c).__name__)
def test_more_is_lost_at_every_step_in_order_and_with_all_fields(condition):
    base = street()
    before, left = bytes_of(base), [len(base.xyz)]
    whole = {row.tobytes(): i for i, row in enumerate(base.xyz)}
    for severity in range(1, 6):
        after = disturb(condition, base, severity)
        rows = np.array([whole[row.tobytes()] for row in after.xyz])
        assert (np.diff(rows) > 0).all()
        for name in ("intensity", "ring", "offset_ns"):
            np.testing.assert_array_equal(getattr(after, name), getattr(base, name)[rows])
        left.append(len(rows))
    assert (np.diff(left) < 0).all()
    assert bytes_of(base) == before


def test_as_many_beams_are_dead_as_asked_for():
    """Defect 6 of reference code: drawn with replacement, 16 of 64 are some 14."""
    base = street(rings=64)
    for severity, dead in enumerate((16, 32, 40, 48, 56), 1):
        after = disturb(BeamDrop(), base, severity)
        rings = np.unique(after.ring)
        assert len(rings) == 64 - dead
        assert len(after.xyz) == np.isin(base.ring, rings).sum()


def test_the_same_beams_are_dead_throughout_a_log_and_others_in_another():
    alive = [
        tuple(np.unique(disturb(BeamDrop(), street(seed=seed, num=num), seed=log).ring))
        for seed, num, log in ((1, 20_000, 0), (2, 9_000, 0), (1, 20_000, 1))
    ]
    assert alive[0] == alive[1] != alive[2]


def test_every_beam_is_dead_in_some_log():
    """Defect 10: choices that never reach the last one."""
    base, alive = street(num=2000), np.zeros(64, int)
    for log in range(40):
        alive[np.unique(disturb(BeamDrop(), base, 2, seed=log).ring)] += 1
    assert ((alive > 0) & (alive < 40)).all()


def test_one_beam_is_left():
    one = cloud(np.ones((5, 3)), ring=np.full(5, 900, np.uint16))
    assert disturb(BeamDrop(), one, 5) is one
    two = cloud(np.ones((6, 3)), ring=np.array([0, 65535] * 3, np.uint16))
    assert len(disturb(BeamDrop(), two, 5).xyz) == 3


@pytest.mark.parametrize(
    ("num", "lost"), [(20_000, (1200, 2400, 3600, 4800, 6000)), (1, (1,) * 5), (10, (1, 1, 2, 2, 3))]
)
def test_density_loses_exactly_its_share_and_one_at_least(num, lost):
    base = cloud(np.arange(3 * num).reshape(num, 3))
    assert tuple(num - len(disturb(Density(), base, s).xyz) for s in range(1, 6)) == lost


def test_density_draws_anew_for_every_message():
    a, b, c = (disturb(Density(), cloud(street().xyz, stamp_ns=stamp)).xyz.tobytes() for stamp in (0, 0, 1))
    assert a == b != c


def test_field_of_view_is_in_the_bodys_axes():
    azimuth = np.radians(np.arange(-179.5, 180))
    base = cloud(np.stack([np.cos(azimuth), np.sin(azimuth), azimuth * 0], axis=1) * 10)
    for severity, half in enumerate((105, 90, 75, 60, 45), 1):
        assert len(disturb(FieldOfView(), base, severity).xyz) == 2 * half
    ahead = disturb(FieldOfView(), base, 5, rotation=QUARTER_LEFT).xyz
    assert (ahead[:, 1] < -7).all()  # the sensor's right is the body's front


def test_holes_are_of_the_nearest_points_and_of_exact_size():
    rng = np.random.default_rng(0)
    base = cloud(rng.uniform(-50, 50, (5000, 3)))
    for severity, holes in enumerate((2, 3, 5, 7, 10), 1):
        assert len(disturb(Cutout(), base, severity).xyz) == 5000 - holes * 100
    grid = cloud(np.repeat(np.arange(100.0), 10)[:, None] * [1, 0, 0])
    after = disturb(Cutout(), grid, 1)
    assert len(after.xyz) == 1000 - 2 * 20


def test_ties_go_in_order():
    """Defect 7: of equally near points an arbitrary one."""
    same = cloud(np.zeros((100, 3)), intensity=np.arange(100))
    assert disturb(Cutout(), same, 1).intensity[0] == 4


def test_the_wall_hides_what_is_behind_it_for_the_whole_log():
    rng = np.random.default_rng(1)
    azimuth, range_m = rng.uniform(-np.pi, np.pi, 40_000), rng.uniform(1, 60, 40_000)
    xyz = np.stack([np.cos(azimuth), np.sin(azimuth), azimuth * 0], axis=1) * range_m[:, None]
    lost = []
    for stamp in (0, 5):
        after = disturb(Occluder(), cloud(xyz, stamp_ns=stamp, ring=np.arange(40_000).astype(np.uint16)), 5)
        gone = np.setdiff1d(np.arange(40_000), after.ring)
        lost.append(gone.tobytes())
        assert range_m[gone].min() > 8.0
        middle = np.median(azimuth[gone])
        assert abs(middle) < np.radians(61)
        off = (azimuth[gone] - middle + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off).max() == pytest.approx(np.arctan(2 / 8), abs=0.02)
        far = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi) < 0.2
        assert set(np.flatnonzero(far & (range_m > 8.5))) <= set(gone)
    assert lost[0] == lost[1]


@pytest.mark.parametrize("condition", LOSSES, ids=lambda c: type(c).__name__)
def test_empty_and_undefined_points(condition):
    ring = np.array([1, 2, 3], np.uint16)
    nowhere = cloud(np.full((3, 3), np.nan), ring=ring)
    assert len(disturb(condition, nowhere).xyz) <= 3
    empty = cloud(np.zeros((0, 3)), ring=ring[:0])
    assert disturb(condition, empty) is empty


def test_objects_lose_an_exact_share_of_their_points():
    truth = Boxes3D(np.array([[20.0, 0, 1]]), np.array([[4.0, 2, 2]]), np.zeros(1))
    rng = np.random.default_rng(0)
    inside = rng.uniform(-0.9, 0.9, (400, 3)) + np.array([0.0, -20, -1])  # ahead; the LiDAR looks to the left
    base = cloud(np.concatenate([inside, street().xyz[:300] + np.float32([0, 40, 0])]))
    for severity, share in enumerate((0.55, 0.65, 0.75, 0.85, 0.95), 1):
        after = disturb(IncompleteEcho(), base, severity, truth=truth, rotation=QUARTER_LEFT)
        assert len(after.xyz) == 700 - round(share * 400)
        assert after.xyz[-300:].tobytes() == base.xyz[-300:].tobytes()
    assert disturb(IncompleteEcho(), base, truth=None) is base
    assert IncompleteEcho().needs == ("truth",)
