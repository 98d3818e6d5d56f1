"""Bootstrap intervals: against a plain loop, seeded, in any order, exact sums."""

import time
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.bootstrap import Bootstrap, Interval, intervals, sum_weighted, with_intervals
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.default import DefaultProfile
from fbench.metrics.tracking.hota import HotaCounts
from fbench.metrics.tracking.scores import TrackingCounts
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score, ratio


@dataclass(frozen=True)
class Share:
    """Hits of some."""

    top: int
    bottom: int
    sum: Fraction = Fraction(0)

    def __add__(self, other: "Share") -> "Share":
        return Share(self.top + other.top, self.bottom + other.bottom, self.sum + other.sum)

    @property
    def value(self) -> float | None:
        return self.top / self.bottom if self.bottom else None


@dataclass(frozen=True)
class Longest:
    """Not a sum of numbers."""

    length: int

    def __add__(self, other: "Longest") -> "Longest":
        return Longest(max(self.length, other.length))


def interval(units, value, how: Bootstrap) -> Interval | str:  # type: ignore[no-untyped-def]
    return intervals(units, lambda total: {"": value(total)}, how)[""]


UNITS = {f"log {i}": Share(i, 10, Fraction(1, 2**i)) for i in range(8)}


def test_as_a_plain_loop_does() -> None:
    how = Bootstrap(seed=3, num=200, share=0.9)
    drawn = generator(3, "bootstrap", 8).integers(0, 8, (200, 8))
    units = [UNITS[name] for name in sorted(UNITS)]
    expected = [sum(units[i].top for i in row) / sum(units[i].bottom for i in row) for row in drawn.tolist()]
    found = interval(UNITS, lambda total: total.value, how)
    assert found == Interval(*(pytest.approx(x) for x in np.quantile(expected, [0.05, 0.95])))


def test_the_order_of_units_changes_nothing_and_the_seed_does() -> None:
    back = dict(reversed(UNITS.items()))
    first, second = (interval(units, lambda total: float(total.sum), Bootstrap()) for units in (UNITS, back))
    assert first == second
    assert interval(UNITS, lambda total: float(total.sum), Bootstrap(seed=1)) != first


def test_equal_units_have_no_spread() -> None:
    units = {str(i): Share(3, 10) for i in range(6)}
    assert interval(units, lambda total: total.value, Bootstrap()) == Interval(0.3, 0.3)


def test_what_isnt_a_sum_is_added_one_by_one() -> None:
    units = {str(i): Longest(i) for i in range(7)}
    assert sum_weighted(list(units.values()), Longest(6), np.ones((1, 7), np.int64)) is None
    how = Bootstrap(num=300)
    drawn = how.times(7)
    expected = [max(np.flatnonzero(row)) for row in drawn]
    assert interval(units, lambda total: float(total.length), how) == Interval(*np.quantile(expected, [0.025, 0.975]))


def test_sums_at_once_are_sums() -> None:
    units = [UNITS[name] for name in sorted(UNITS)]
    times = Bootstrap(num=20).times(8)
    quick = sum_weighted(units, sum(units[1:], units[0]), times)
    assert quick is not None
    for total, row in zip(quick, times.tolist(), strict=True):
        plain = [unit for unit, num in zip(units, row, strict=True) for _ in range(num)]
        assert total == sum(plain[1:], plain[0])


def test_few_units_have_a_reason_instead() -> None:
    few = {name: UNITS[name] for name in list(UNITS)[:4]}
    assert interval(few, lambda total: total.value, Bootstrap()) == "4 logs, at least 5 are needed"
    assert intervals({}, lambda total: {"a": 1.0}, Bootstrap()) == {}


def test_what_is_undefined_too_often_has_a_reason_instead() -> None:
    units = {str(i): Share(1, 1) if i == 0 else Share(0, 0) for i in range(6)}
    found = interval(units, lambda total: total.value, Bootstrap())
    assert isinstance(found, str)
    assert found.startswith("undefined in ")
    often = {str(i): Share(0, 0) if i == 0 else Share(1, 1) for i in range(6)}
    assert interval(often, lambda total: total.value, Bootstrap()) == Interval(1.0, 1.0)


def test_ends_of_resamples() -> None:
    how = Bootstrap(num=100, share=0.9)
    own = np.arange(100.0)
    assert how.interval(own) == (pytest.approx(4.95), pytest.approx(94.05))
    own[:5] = np.nan  # 5 % may be undefined, and it doesn't matter whether they are left out
    assert how.interval(own) == how.interval(own[5:]) == (pytest.approx(9.7), pytest.approx(94.3))
    own[5] = np.inf
    assert how.interval(own) == how.interval(own[6:]) == how.interval(None) == (None, None)


@pytest.mark.parametrize("bad", [{"num": 0}, {"share": 0.0}, {"share": 1.0}])
def test_settings_that_mean_nothing_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="bootstrap"):
        Bootstrap(**bad)  # type: ignore[arg-type]


def test_rows_with_intervals() -> None:
    def rows(total: Share) -> list[Score]:
        return [ratio(name, "car", "m", total.top, total.bottom, "nothing", {}) for name in ("one", "other")]

    one, other = with_intervals(UNITS, rows, Bootstrap(), "logs", ["one"])
    assert one.low is not None
    assert one.high is not None
    assert one.low < (one.value or 0) < one.high
    assert one.interval == "95 % of 1000 bootstrap resamples of 8 logs"
    assert (other.low, other.high, other.interval) == (None, None, None)


def test_sequences_of_any_profile() -> None:
    rng = np.random.Generator(np.random.PCG64(1))
    sequences = []
    for i in range(6):
        truth = [Box(s, 10.0 * k, id=k) for s in range(5) for k in range(1, 4)]
        found = [Box(s, 10.0 * k, id=k, score=0.5) for s in range(5) for k in range(1, 4) if rng.random() < 0.7]
        one = sequence(truth, found, 5)
        sequences.append(type(one)(f"s{i}", one.steps, one.truth, one.estimates))
    evaluation = evaluate(DefaultProfile(Match("bev", 2.0)), sequences)
    rows = {
        row.metric: row for row in evaluation.scores(Bootstrap(num=50)) if (row.class_, row.slice) == ("vehicle", "all")
    }
    for metric in ("f1", "mota", "hota", "idf1", "ap"):
        row = rows[metric]
        assert row.low is not None
        assert row.high is not None
        assert row.low <= (row.value or 0) <= row.high, metric
        assert row.interval == "95 % of 50 bootstrap resamples of 6 sequences"


def test_a_thousand_resamples_of_21_sequences_of_fractions_take_no_time() -> None:
    sums = tuple(Fraction(i + 1, 2**60) for i in range(19))
    units = {
        str(i): TrackingCounts(hota=HotaCounts((i,) * 19, (1,) * 19, (2,) * 19, sums, sums, sums, sums))
        for i in range(21)
    }
    begin = time.process_time()
    assert isinstance(interval(units, lambda total: float(total.hota.ass_a[0]), Bootstrap()), Interval)
    assert time.process_time() - begin < 10
