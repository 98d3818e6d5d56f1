"""Comparing scores: verdicts, regression and refusals."""

from collections.abc import Sequence

import pytest
from tests.metrics.conftest import make_manifest

from fbench.metrics.comparison.cells import CellName, CellPair, CellSide, Stretches
from fbench.metrics.comparison.verdicts import Judge, Rule, default_rules
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.comparison import Row
from fbench.replay.data.scores import Score


def compare(base: Sequence[Score], head: Sequence[Score], tolerance: float) -> list[Row]:
    """Judge scores alone, without counts of stretches."""
    one, two = (CellSide(make_manifest(), scores, None, Stretches("", {}, ())) for scores in (base, head))
    return Judge(default_rules(tolerance)).judge([CellPair(CellName("log", "lidar3d"), one, two)])[0]


def is_worse(base: Sequence[Score], head: Sequence[Score], tolerance: float) -> bool:
    return any(row.gate and row.verdict == "REGRESSED" for row in compare(base, head, tolerance))


def score(
    metric: str, value: float | None, class_: str = "vehicle", matching: str = "bev 2 m", unit: str = "1"
) -> Score:
    return Score(metric, class_, "all", matching, value, None if value is not None else "no truth", unit)


def verdict(metric: str, base: float | None, head: float | None, unit: str = "1", tolerance: float = 0.01) -> str:
    """Verdict on a number that gates."""
    one, two = (
        [score(metric, value, unit=unit), score("mota" if metric == "f1" else "f1", 0.5)] for value in (base, head)
    )
    sides = (CellSide(make_manifest(), side, None, Stretches("", {}, ())) for side in (one, two))
    rules = [Rule(metric, tolerance=tolerance)]
    return Judge(rules).judge([CellPair(CellName("log", "lidar3d"), *sides)])[0][0].verdict


@pytest.mark.parametrize(
    ("base", "head", "expected"),
    [(0.8, 0.8, "same"), (0.8, 0.79, "same"), (0.8, 0.81, "same"), (0.8, 0.78, "REGRESSED"), (0.8, 0.82, "improved"),
     (0.8, None, "REGRESSED"), (None, 0.8, "null"), (None, None, "null")],
)  # fmt: skip
def test_verdicts(base: float | None, head: float | None, expected: str) -> None:
    assert verdict("f1", base, head) == expected


def test_fewer_switches_and_smaller_distances_are_better() -> None:
    assert verdict("idsw", 5, 3) == "improved"
    assert verdict("idsw", 3, 5) == "REGRESSED"
    assert verdict("motp", 0.5, 0.3, unit="m") == "improved"
    assert verdict("motp", 0.5, 0.7, unit="iou") == "improved"
    assert (verdict("ml", 3, 5), verdict("mt", 3, 5), verdict("frag", 3, 5)) == ("REGRESSED", "improved", "REGRESSED")


def test_numbers_that_are_neither_good_nor_bad_only_change() -> None:
    assert verdict("pt", 3, 5) == "changed"


def test_rows_keep_the_bases_order_and_name_what_is_gone_and_new() -> None:
    base = [score("f1", 0.5), score("recall", 0.5), score("f1", 0.4, class_="car")]
    head = [score("f1", 0.5, class_="bus"), score("recall", 0.7), score("f1", 0.5)]
    rows = compare(base, head, 0.0)
    assert [(r.metric, r.class_, r.verdict) for r in rows] == [
        ("f1", "vehicle", "same"), ("recall", "vehicle", "INCONCLUSIVE"), ("f1", "car", "gone"), ("f1", "bus", "new"),
    ]  # fmt: skip
    assert (rows[1].base, rows[1].head) == (0.5, 0.7)
    assert rows[1].delta == pytest.approx(0.2)
    assert [r.primary for r in rows] == [True, False, False, False]


BASE = (score("f1", 0.8), score("precision", 0.9), score("mota", 0.6), score("f1", 0.7, matching="iou 0.5"))


@pytest.mark.parametrize(
    ("metric", "matching", "value", "regressed"),
    [
        ("f1", "bev 2 m", 0.78, True),
        ("mota", "bev 2 m", 0.5, True),
        ("mota", "bev 2 m", None, True),
        ("f1", "bev 2 m", 0.795, False),
        ("f1", "bev 2 m", 0.95, False),
        ("precision", "bev 2 m", 0.1, False),
        ("f1", "iou 0.5", 0.1, False),
    ],
)
def test_only_primary_rows_decide(metric: str, matching: str, value: float | None, regressed: bool) -> None:
    head = [
        score(metric, value, matching=matching) if (s.metric, s.matching) == (metric, matching) else s for s in BASE
    ]
    assert is_worse(BASE, head, 0.01) is regressed


def test_a_primary_row_that_is_gone_is_a_regression() -> None:
    assert is_worse(BASE, [s for s in BASE if s.metric != "mota"], 0.01)


def test_what_was_null_already_is_no_regression() -> None:
    base = [score("f1", 0.8), score("mota", None)]
    assert not is_worse(base, base, 0.0)
    assert not is_worse(base, [score("f1", 0.8), score("mota", 0.1)], 0.0)


def test_equal_runs_dont_regress_at_tolerance_zero() -> None:
    assert {r.verdict for r in compare(BASE, BASE, 0.0)} == {"same"}
    assert not is_worse(BASE, BASE, 0.0)


def test_scores_without_a_common_primary_row_are_refused() -> None:
    head = [score("f1", 0.9, matching="bev 4 m"), score("f1", 0.7, matching="iou 0.5")]
    with pytest.raises(
        MetricError, match=r"nothing to compare: base has f1 of vehicle \(bev 2 m\), head has .*bev 4 m"
    ):
        compare(BASE, head, 0.0)
    with pytest.raises(MetricError, match="base has neither f1 nor mota"):
        compare([], BASE, 0.0)


@pytest.mark.parametrize("tolerance", [-0.1, float("nan")])
def test_a_tolerance_below_zero_is_refused(tolerance: float) -> None:
    with pytest.raises(ConfigError, match="expected a number from 0 on"):
        compare(BASE, BASE, tolerance)
