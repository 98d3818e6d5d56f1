"""Intervals, tests and smallest differences: by hand, and how often they are right."""

import numpy as np
import pytest

from fbench.metrics.comparison.counts import RATIOS
from fbench.metrics.comparison.inference import ErrorRates, PairedUnits, adjust_discoveries, adjust_holm
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Int64

F1 = RATIOS["detection"]["f1"]
FAST = ErrorRates(num_resamples=400, num_flips=999)


def counts(random: np.random.Generator, num_units: int, share: float = 0.8) -> Int64:
    truth = random.poisson(25, num_units) + 5
    hits = random.binomial(truth, share)
    return np.column_stack([hits, random.poisson(2, num_units), truth - hits]).astype(np.int64)


def test_holm_and_benjamini_hochberg_by_hand() -> None:
    p = [0.01, 0.04, 0.03, 0.005]
    assert adjust_holm(p) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjust_discoveries(p) == pytest.approx([0.02, 0.04, 0.04, 0.02])
    assert adjust_holm([]) == adjust_discoveries([]) == []


def test_the_exact_test_counts_all_swaps() -> None:
    """Six units, all of which lost one hit: only two of 64 swaps are as far from zero."""
    base = np.tile([10, 0, 0], (6, 1))
    head = np.tile([9, 0, 1], (6, 1))
    assert PairedUnits(6, FAST).infer(base, head, F1).p == pytest.approx(2 / 64)


def test_equal_counts_show_no_difference_but_say_what_would_be_seen() -> None:
    base = counts(np.random.default_rng(0), 30)
    found = PairedUnits(30, FAST).infer(base, base, F1)
    assert (found.low, found.high, found.p, found.delta) == (0.0, 0.0, 1.0, 0.0)
    smallest = found.smallest(FAST, 1)
    assert smallest is not None
    # About z squared boxes of what one is worth: 1.96 / sqrt(1 - 1.96² / 30) = 2.099, and 1.311 for the power.
    assert smallest == pytest.approx((2.0990 + 1.3114) ** 2 * found.per_box, rel=1e-3)


@pytest.mark.parametrize(("num_units", "num_judged"), [(4, 1), (6, 10)])
def test_too_few_units_can_show_nothing(num_units: int, num_judged: int) -> None:
    base = counts(np.random.default_rng(0), num_units)
    assert PairedUnits(num_units, FAST).infer(base, base, F1).smallest(FAST, num_judged) is None


def test_what_is_undefined_stays_so() -> None:
    nothing = np.zeros((8, 3), np.int64)
    found = PairedUnits(8, FAST).infer(nothing, counts(np.random.default_rng(0), 8), F1)
    assert (found.base, found.delta, found.p, found.reason) == (None, None, None, "undefined")


def test_levels_out_of_range_are_refused() -> None:
    with pytest.raises(ConfigError, match="alpha"):
        ErrorRates(alpha=0.7)


def test_false_alarms_power_and_coverage() -> None:
    """Of runs that differ by chance alone few alarm; drops of the stated size are found; intervals hold the truth."""
    num, trials, units = 24, 120, PairedUnits(24, FAST)
    alarms = found = held = 0
    for trial in range(trials):
        random = np.random.default_rng(trial)
        base, head = counts(random, num), counts(random, num)
        inferred = units.infer(base, head, F1)
        assert inferred.p is not None
        assert inferred.low is not None
        assert inferred.high is not None
        alarms += inferred.p < FAST.alpha
        held += inferred.low <= 0 <= inferred.high
        size = inferred.smallest(FAST, 1)
        assert size is not None
        worse = units.infer(base, counts(random, num, 0.8 - 1.63 * size), F1)
        # One hit of 30 is worth 0.0204 of F1 at 24 hits and 2 false alarms, so that a share of them is worth 0.612.
        found += (worse.p or 0) < FAST.alpha
    assert alarms <= 0.1 * trials
    assert held >= 0.88 * trials
    assert found >= 0.8 * trials


@pytest.mark.parametrize("num_judged", [1, 2, 10, 100])
def test_so_many_units_can_show_a_change_at_all(num_judged: int) -> None:
    """All units lost all hits; of one unit less even that could be chance."""
    least = FAST.least_units(num_judged)
    for num, is_shown in ((least - 1, False), (least, True)):
        how = ErrorRates(num_flips=max(2**num, 100))
        base, head = (np.tile(row, (num, 1)) for row in ([9, 0, 0], [0, 0, 9]))
        p = PairedUnits(num, how).test(base, head, F1)
        assert p is not None
        assert (p * num_judged < how.alpha) is is_shown
