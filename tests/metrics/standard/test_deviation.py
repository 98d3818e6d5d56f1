"""Errors of distance and range rate by hand."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.slices import VEHICLE, ScoreKey
from fbench.metrics.detection.scores import Deviation, detection_counts, deviation_rows, range_rates
from fbench.replay.contracts.profiles import Match

MATCH = Match("bev", 2.0)
HEAD = ScoreKey("vehicle", "all", "iou 0.5", None, 1)


def test_the_mean_absolute_error_of_hits_that_tell_it() -> None:
    truth = [Box(0, x, distance=d) for x, d in ((10, 10), (20, 20), (30, np.nan), (40, 40))]
    found = [Box(0, x, distance=d) for x, d in ((10, 10.5), (20, 18.0), (30, 30), (40, np.nan), (60, 1))]
    counts = detection_counts(sequence(truth, found, 1), VEHICLE, MATCH)
    assert counts.distance == Deviation(Fraction(5, 2), 2)
    distance, rate = deviation_rows(counts, HEAD)
    assert (distance.metric, distance.value, distance.unit) == ("distance_error", 1.25, "m")
    assert distance.counts == {"hits": 2, "error_sum": 2.5}
    assert (rate.value, rate.reason) == (None, "no hit tells its range rate")


def test_recorded_range_rates_go_before_derived_ones() -> None:
    truth = [Box(0, 10, distance=10, rate=3.0)]
    found = [Box(0, 10, rate=2.0)]
    assert detection_counts(sequence(truth, found, 1), VEHICLE, MATCH).range_rate == Deviation(Fraction(1), 1)


def test_range_rates_are_central_differences_on_a_track() -> None:
    # Distances 10, 11, 13 at 0.1 s: (13 - 10) / 0.2 s = 15 m/s in the middle, unknown at the ends.
    truth = [Box(i, 10, id=4, distance=d) for i, d in enumerate((10, 11, 13))]
    rates = range_rates(sequence(truth, [], 3))
    assert rates is not None
    assert rates.tolist() == [
        pytest.approx(np.nan, nan_ok=True),
        pytest.approx(15.0),
        pytest.approx(np.nan, nan_ok=True),
    ]


@pytest.mark.parametrize(
    ("ids", "steps", "streams"),
    [([4, 4, 5], [0, 1, 2], [0, 0, 0, 0]), ([4, 4, 4], [0, 1, 3], [0, 0, 0, 0]), ([4, 4, 4], [0, 1, 2], [0, 0, 1, 1]),
     ([-1, -1, -1], [0, 1, 2], [0, 0, 0, 0])],
)  # fmt: skip
def test_no_range_rate_across_ids_gaps_and_streams(ids: list[int], steps: list[int], streams: list[int]) -> None:
    truth = [Box(s, 10, id=i, distance=10.0 + s) for s, i in zip(steps, ids, strict=True)]
    rates = range_rates(sequence(truth, [], 4, streams))
    assert rates is not None
    assert np.isnan(rates).all()


def test_equal_stamps_give_no_range_rate() -> None:
    truth = [Box(i, 10, id=4, distance=10.0 + i) for i in range(3)]
    rates = range_rates(sequence(truth, [], 3, period_s=0.0))
    assert rates is not None
    assert np.isnan(rates).all()


def test_two_streams_side_by_side_dont_meet() -> None:
    """Two cameras: steps of both alternate."""
    truth = [Box(i, 10, id=4, distance=10.0 + i) for i in range(6)]
    rates = range_rates(sequence(truth, [], 6, [0, 1, 0, 1, 0, 1]))
    assert rates is not None
    assert np.flatnonzero(np.isfinite(rates)).tolist() == [2, 3]
    assert rates[2] == pytest.approx(4 / 0.4)


def test_nothing_is_known_without_distances() -> None:
    one = sequence([Box(0, 10)], [Box(0, 10)], 1)
    bare = replace(one, truth=replace(one.truth, distance_m=None), estimates=replace(one.estimates, distance_m=None))
    assert range_rates(bare) is None
    assert detection_counts(bare, VEHICLE, MATCH).distance == Deviation()


def test_sums_are_exact_in_any_order() -> None:
    parts = [Deviation.of(np.array([0.0]), np.array([value])) for value in (0.1, 1e16, 0.2, -1e16, 0.3)]
    forth, back = sum(parts, Deviation()), sum(reversed(parts), Deviation())
    assert forth == back


def test_sums_of_a_part_at_a_time_are_those_of_the_whole() -> None:
    values = np.random.Generator(np.random.PCG64(1)).random(200)
    parts = [Deviation.of(np.zeros(1), value[None]) for value in values]
    assert sum(parts, Deviation()) == Deviation.of(np.zeros(200), values)


def test_the_date_doesnt_matter() -> None:
    """Stamps since 1970 don't fit a float to the nanosecond."""
    truth = [Box(i, 10, id=4, distance=10.0 + i / 3) for i in range(3)]
    one = sequence(truth, [], 3)
    later = replace(one, steps=replace(one.steps, stamp_ns=one.steps.stamp_ns + 1_700_000_000_123_456_789))
    early, late = range_rates(one), range_rates(later)
    assert early is not None
    assert late is not None
    assert early.tolist()[1] == late.tolist()[1]
