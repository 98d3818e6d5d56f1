"""Noise of clouds: its size, whom it hits, and that rotations stay rotations."""

import numpy as np
import pytest
from tests.replay.conditions.sites import bytes_of, cloud, disturb, level, street

from fbench.replay.conditions.lidar.noise import (
    BulkMotion,
    Crosstalk,
    DeskewError,
    Glare,
    Impulse,
    Jitter,
    UniformNoise,
    turn_by,
)

NOISES = [BulkMotion(), Crosstalk(), DeskewError(), Glare(), Impulse(), Jitter(), UniformNoise()]


def shift(condition, base, severity, **where):
    return disturb(condition, base, severity, **where).xyz.astype(np.float64) - base.xyz


@pytest.mark.parametrize("condition", NOISES, ids=lambda c: type(c).__name__)
def test_only_places_change_and_further_at_every_step(condition):
    """Defect 7 of reference code: noise on all columns, of the input itself."""
    base = street()
    before = bytes_of(base)
    means = []
    for severity in range(1, 6):
        after = disturb(condition, base, severity)
        for name in ("intensity", "ring", "offset_ns"):
            assert getattr(after, name).tobytes() == getattr(base, name).tobytes()
        assert np.isfinite(after.xyz).all()
        means.append(np.mean([np.abs(shift(condition, base, severity, seed=seed)).mean() for seed in range(12)]))
    assert bytes_of(base) == before
    assert means[0] > 0
    assert (np.diff(means) > 0).all()


def test_sizes_of_noise():
    base = cloud(np.zeros((40_000, 3)))
    for severity, size in enumerate((0.02, 0.04, 0.06, 0.08, 0.10), 1):
        normal, even = shift(Jitter(), base, severity), shift(UniformNoise(), base, severity)
        assert normal.std(axis=0) == pytest.approx([size] * 3, rel=0.02)
        assert normal.mean(axis=0) == pytest.approx([0] * 3, abs=0.02 * size)
        assert even.min() == pytest.approx(-size, rel=1e-3)
        assert even.max() == pytest.approx(size, rel=1e-3)
        assert even.std() == pytest.approx(size / np.sqrt(3), rel=0.02)


@pytest.mark.parametrize(
    ("condition", "shares", "sigma"),
    [(Impulse(), (1 / 30, 1 / 25, 1 / 20, 1 / 15, 1 / 10), 0.1),
     (Crosstalk(), (0.004, 0.008, 0.012, 0.016, 0.02), 3.0),
     (Glare(), (0.01, 0.02, 0.03, 0.04, 0.05), 2.0)],
)  # fmt: skip
def test_strays_are_as_many_as_they_should_be(condition, shares, sigma):
    base = cloud(np.zeros((30_000, 3)))
    for severity, share in enumerate(shares, 1):
        off = shift(condition, base, severity)
        moved = np.abs(off).max(axis=1) > 0
        assert moved.sum() == round(share * 30_000)
        assert off[moved].std() == pytest.approx(sigma, rel=0.1)
    assert set(np.unique(np.abs(shift(Impulse(), base, 3)).round(4))) == {0.0, 0.1}


def test_bulk_motion_is_one_shift_with_a_little_jitter():
    base = cloud(np.zeros((20_000, 3)))
    common = np.array([shift(BulkMotion(), base, 5, seed=seed).mean(axis=0) for seed in range(200)])
    assert common.std() == pytest.approx(0.10, rel=0.1)
    off = shift(BulkMotion(), base, 5)
    assert (off - off.mean(axis=0)).std() == pytest.approx(0.01, rel=0.02)


def test_rotations_by_vectors_are_rotations():
    """Defect 7: noise on matrices leaves SO(3). R^T R = I to 1e-12, against the matrix exponential."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(0)
    vectors = np.concatenate([rng.normal(0, 1, (200, 3)), rng.normal(0, 1e-9, (20, 3)), np.zeros((1, 3))])
    columns = [turn_by(vectors, np.tile(axis, (len(vectors), 1))) for axis in np.eye(3)]
    matrices = np.stack(columns, axis=2)
    assert np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max() < 1e-12
    assert np.abs(matrices - Rotation.from_rotvec(vectors).as_matrix()).max() < 1e-12


def test_deskew_error_moves_points_of_one_instant_as_one():
    rng = np.random.default_rng(0)
    base = cloud(rng.uniform(-30, 30, (600, 3)), offset_ns=np.repeat(np.arange(60) * 1_000_000, 10).astype(np.int32))
    moved = disturb(DeskewError(), base, 5).xyz.astype(np.float64)
    for first in range(0, 600, 10):
        a, b = base.xyz[first : first + 10].astype(np.float64), moved[first : first + 10]
        before, after = (np.sqrt(((p[:, None] - p[None]) ** 2).sum(axis=2)) for p in (a, b))
        np.testing.assert_allclose(after, before, atol=2e-5)
    where = np.abs(moved - base.xyz).max(axis=1).reshape(60, 10).mean(axis=1)
    assert where.std() > 0
    still = cloud(np.zeros((1100, 3)), offset_ns=np.arange(1100).astype(np.int32))
    knots = np.array([shift(DeskewError(), still, 5, seed=seed)[0] for seed in range(300)])
    assert knots.std() == pytest.approx(level(DeskewError(), 5)["sigma_m"], rel=0.1)


@pytest.mark.parametrize("condition", NOISES, ids=lambda c: type(c).__name__)
def test_undefined_points_stay_so_and_empty_clouds_empty(condition):
    holed = cloud(np.array([[np.nan, 0, 0], [1, 2, 3], [1, 2, 4]]), offset_ns=np.zeros(3, np.int32))
    after = disturb(condition, holed)
    assert np.isnan(after.xyz[0, 0])
    assert np.isfinite(after.xyz[1:]).all()
    empty = cloud(np.zeros((0, 3)), offset_ns=np.zeros(0, np.int32))
    assert disturb(condition, empty) is empty
