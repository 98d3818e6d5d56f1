"""Echoes that are lost, merged, or measured wrongly."""

import numpy as np
import pytest
from tests.replay.conditions.sites import bytes_of, disturb, fields_of, has_consistent_polar, level, scan, standing

from fbench.replay.conditions.radar.echoes import Sensitivity
from fbench.replay.conditions.radar.measurement import (
    AzimuthError,
    DopplerAlias,
    Interference,
    Nonpositional,
    PointLoss,
    Resolution,
    Shift,
)
from fbench.replay.contracts.errors import LogError

CONDITIONS = [
    AzimuthError(), DopplerAlias(), Interference(), Nonpositional(), PointLoss(), Resolution(), Shift(),
]  # fmt: skip


def size(condition, base, severity):
    """How much changes: echoes that are gone, else the mean of what moves, turns and differs."""
    after = disturb(condition, base, severity)
    if len(after.xyz) != len(base.xyz):
        return len(base.xyz) - len(after.xyz)
    before = fields_of(base)
    return sum(float(np.abs(a.astype(np.float64) - before[name]).mean()) for name, a in fields_of(after).items())


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: type(c).__name__)
def test_more_changes_at_every_step_and_polar_values_agree(condition):
    base = standing()
    before = bytes_of(base)
    sizes = [size(condition, base, severity) for severity in range(1, 6)]
    assert sizes[0] > 0
    assert (np.diff(sizes) > 0).all()
    after = disturb(condition, base, 5)
    assert has_consistent_polar(after)
    assert all(np.isfinite(a).all() for a in fields_of(after).values())
    assert {name: a.dtype for name, a in fields_of(after).items()} == {n: a.dtype for n, a in fields_of(base).items()}
    assert bytes_of(base) == before
    assert bytes_of(disturb(condition, base, 5)) == bytes_of(after)


def test_exactly_the_share_is_lost():
    for severity, share in enumerate((0.1, 0.2, 0.3, 0.4, 0.5), 1):
        assert len(disturb(PointLoss(), standing(num=1234), severity).xyz) == 1234 - round(share * 1234)


def test_interference_drowns_what_is_less_above_the_noise():
    base = standing()
    margin = Sensitivity(base).margin_db
    for severity, noise_db in enumerate((3, 6, 9, 12, 15), 1):
        after = disturb(Interference(), base, severity)
        np.testing.assert_array_equal(after.xyz, base.xyz[margin >= noise_db])
        assert len(after.xyz) == pytest.approx(2000 * (1 - noise_db / 30), rel=0.1)


def test_shifts_stay_in_the_plane_and_leave_doppler_and_strength():
    base = standing(num=20_000)
    after = disturb(Shift(), base, 5)
    off = after.xyz.astype(np.float64) - base.xyz
    assert off[:, :2].std(axis=0) == pytest.approx([1.6, 1.6], rel=0.03)
    assert (off[:, 2] == 0).all()
    for name in ("radial_velocity_mps", "rcs_dbsm"):
        assert getattr(after, name).tobytes() == getattr(base, name).tobytes()


def test_azimuth_errors_keep_range_and_altitude():
    base = standing(num=20_000)
    after = disturb(AzimuthError(), base, 4)
    np.testing.assert_allclose(after.range_m, base.range_m, rtol=1e-5)
    np.testing.assert_allclose(after.altitude_rad, base.altitude_rad, atol=1e-5)
    assert np.degrees((after.azimuth_rad - base.azimuth_rad).std()) == pytest.approx(2.0, rel=0.03)


def test_echoes_of_a_cell_become_one_whose_power_is_their_sum():
    base = scan([[10.1, 0.05, 0], [10.2, 0.05, 1], [30, 0, 0]], [1.0, 2.0, 3.0], [0.0, 10.0, 5.0], has_polar=True)
    after = disturb(Resolution(), base, 3)
    np.testing.assert_allclose(after.radial_velocity_mps, [2.0, 3.0])
    np.testing.assert_allclose(after.rcs_dbsm, [10 * np.log10(1 + 10), 5.0], rtol=1e-6)
    np.testing.assert_allclose(after.range_m, [10.5, 30.5], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(after.azimuth_rad), [1.5, 1.5], rtol=1e-5)
    assert after.altitude_rad[0] == pytest.approx(np.arctan2(1, 10.2), abs=1e-3)
    cells = disturb(Resolution(), standing(), 5)
    step = level(Resolution(), 5)
    index = np.floor(cells.range_m / step["cell_m"]), np.floor(np.degrees(cells.azimuth_rad) / step["cell_deg"])
    assert len(set(zip(*index, strict=True))) == len(cells.xyz)


def test_strength_and_doppler_scatter():
    base = standing(num=20_000)
    after = disturb(Nonpositional(), base, 5)
    assert after.xyz.tobytes() == base.xyz.tobytes()
    assert (after.rcs_dbsm - base.rcs_dbsm).std() == pytest.approx(8, rel=0.03)
    assert (after.radial_velocity_mps - base.radial_velocity_mps).std() == pytest.approx(2, rel=0.03)
    only = disturb(Nonpositional(), scan(base.xyz, base.radial_velocity_mps), 5)
    assert only.rcs_dbsm is None
    with pytest.raises(LogError, match="'radar' has no rcs, velocity"):
        disturb(Nonpositional(), scan(base.xyz), 5)


def test_wrong_doppler_is_off_by_the_interval_towards_the_other_side():
    base = scan(np.ones((1000, 3)), np.where(np.arange(1000) % 2, 4.0, -6.0))
    for severity, num in enumerate((20, 50, 100, 200, 400), 1):
        off = disturb(DopplerAlias(), base, severity).radial_velocity_mps - base.radial_velocity_mps
        assert np.count_nonzero(off) == num
        moved = off != 0
        np.testing.assert_array_equal(off[moved], np.where(base.radial_velocity_mps[moved] > 0, -20, 20))
    assert DopplerAlias().needs == ("velocity",)


@pytest.mark.parametrize("condition", CONDITIONS, ids=lambda c: type(c).__name__)
def test_empty_scans_and_undefined_points(condition):
    empty = scan(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    assert disturb(condition, empty) is empty
    holed = scan([[np.nan, 0, 0], [20, 1, 0], [50, 1, 0]], [0.0, 2.0, 1.0], [10.0, 10.0, 12.0])
    assert len(disturb(condition, holed, 1).xyz) <= 3
