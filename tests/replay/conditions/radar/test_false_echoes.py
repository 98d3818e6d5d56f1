"""Echoes where nothing is: their number, place, strength and Doppler."""

import numpy as np
import pytest
from tests.replay.conditions.sites import bytes_of, disturb, fields_of, has_consistent_polar, scan, standing

from fbench.replay.conditions.radar.echoes import Sensitivity, standing_mps
from fbench.replay.conditions.radar.false_echoes import Clutter, Ghost, Spurious

FALSE = [Clutter(), Ghost(), Spurious()]


def new(condition, base, severity, **where):
    """The added part."""
    after = disturb(condition, base, severity, **where)
    num = len(base.xyz)
    assert all(bytes_of(base)[k] == a[:num].tobytes() for k, a in fields_of(after).items())
    assert has_consistent_polar(after)
    return {name: a[num:] for name, a in fields_of(after).items()}


@pytest.mark.parametrize("condition", FALSE, ids=lambda c: type(c).__name__)
def test_more_are_added_at_every_step_after_the_scans_own(condition):
    base = standing()
    before = bytes_of(base)
    counts = [np.mean([len(new(condition, base, s, seed=seed)["xyz"]) for seed in range(8)]) for s in range(1, 6)]
    assert counts[0] > 0
    assert (np.diff(counts) > 0).all()
    assert bytes_of(base) == before
    a, b, c = (bytes_of(disturb(condition, base, seed=seed)) for seed in (0, 0, 1))
    assert a == b != c


@pytest.mark.parametrize("condition", [Clutter(), Spurious()])
def test_false_echoes_stand_over_ground_as_the_scan_shows(condition):
    """-v cos(azimuth) at 10 m/s, with 0.5 m/s of drops, or as points stand."""
    added = new(condition, standing(), 5)
    flat = -10 * np.cos(added["azimuth_rad"].astype(np.float64))
    off = added["radial_velocity_mps"] - flat
    assert np.abs(np.median(off)) < 0.2
    assert off.std() < 0.8


def test_clutter_is_poisson_near_and_weak():
    base = standing()
    parts = [new(Clutter(), base, 5, seed=seed) for seed in range(200)]
    counts = np.array([len(part["xyz"]) for part in parts])
    assert counts.mean() == pytest.approx(40, abs=1.5)
    assert counts.var() == pytest.approx(40, rel=0.35)
    range_m, rcs = (np.concatenate([part[name] for part in parts]) for name in ("range_m", "rcs_dbsm"))
    assert range_m.min() >= 0.999
    assert np.median(range_m) == pytest.approx(10, rel=0.1)  # of 1 to 100 m, by 1 / r
    assert rcs.mean() == pytest.approx(-10, abs=0.3)
    assert rcs.std() == pytest.approx(5, rel=0.05)


def test_ghosts_lie_behind_strong_echoes_in_their_direction():
    base, sensitivity = standing(), Sensitivity(standing())
    added = new(Ghost(), base, 5)
    unit = base.xyz / np.sqrt((base.xyz.astype(np.float64) ** 2).sum(axis=1))[:, None]
    parents = []
    for xyz, rcs, speed in zip(added["xyz"], added["rcs_dbsm"], added["radial_velocity_mps"], strict=True):
        far = np.sqrt((xyz.astype(np.float64) ** 2).sum())
        parent = int(np.argmax(unit @ (xyz / far)))
        parents.append(parent)
        assert 0.99 < far - base.range_m[parent] < 10.01
        assert rcs == pytest.approx(base.rcs_dbsm[parent] - 10, abs=1e-3)
        assert rcs >= sensitivity.weakest_db(np.array([far]))[0] - 1e-3
        once = base.radial_velocity_mps[parent]
        assert min(abs(speed - once), abs(speed - 2 * once)) < 1e-4
        assert abs(speed) <= 10.001  # of an ambiguous sensor, nothing that it can't give
    assert len(set(parents)) == len(parents)
    assert added["range_m"].max() <= base.range_m.max() + 1e-3


def test_spurious_points_are_a_share_all_over_the_view_and_strong_enough():
    base = standing()
    for severity, share in enumerate((0.1, 0.2, 0.3, 0.4, 0.5), 1):
        assert len(new(Spurious(), base, severity)["xyz"]) == round(share * len(base.xyz))
    added = new(Spurious(), base, 5)
    assert np.degrees(added["azimuth_rad"]).std() == pytest.approx(100 / np.sqrt(12), rel=0.05)
    assert added["range_m"].std() == pytest.approx(97 / np.sqrt(12), rel=0.05)
    weakest = Sensitivity(base).weakest_db(added["range_m"].astype(np.float64))
    assert (added["rcs_dbsm"] >= weakest - 1e-3).all()


def test_standing_things_have_the_median_speed_of_their_direction():
    base = standing(num=4000)
    to = np.radians([-40.0, 0.0, 30.0])
    np.testing.assert_allclose(standing_mps(base, to), -10 * np.cos(to), atol=0.2)
    few = scan([[10, 0, 0], [0, 10, 0]], [3.0, 5.0])
    np.testing.assert_allclose(standing_mps(few, np.array([0.0])), [4.0])
    assert standing_mps(scan([[10, 0, 0]]), to).tolist() == [0, 0, 0]


@pytest.mark.parametrize("condition", FALSE, ids=lambda c: type(c).__name__)
def test_sensors_without_doppler_strength_or_polar_values(condition):
    bare = scan(standing().xyz)
    after = disturb(condition, bare, 5)
    assert set(fields_of(after)) == {"xyz"}
    assert len(after.xyz) >= len(bare.xyz)
    assert np.isfinite(after.xyz).all()


@pytest.mark.parametrize("condition", FALSE, ids=lambda c: type(c).__name__)
def test_empty_scans_and_points_that_are_nowhere(condition):
    empty = scan(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    assert disturb(condition, empty) is empty
    nowhere = scan(np.full((2, 3), np.nan), np.zeros(2), np.zeros(2))
    assert len(disturb(condition, nowhere).xyz) == 2
    holed = scan([[np.nan, 0, 0], [20, 1, 0], [50, 1, 0]], [0.0, np.nan, 1.0], [10.0, 10.0, np.nan])
    assert np.isfinite(disturb(condition, holed, 5).xyz[1:]).all()
