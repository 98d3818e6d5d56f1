"""AP, APH and longitudinal tolerance in cases that can be told by hand, and against a search over all matches."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.metrics.core.similarity import blocks
from fbench.metrics.profiles.av2.detection import Av2Detection
from fbench.metrics.profiles.remarks import Remarks
from fbench.metrics.profiles.waymo.measure import CUTOFFS
from fbench.metrics.profiles.waymo.profile import WaymoProfile, average_precision
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps

Box = tuple[float, float, float, float]  # x, y, heading, score


def side(frames: list[list[Box]], points: list[int] | None = None, label: str = "car") -> Objects:
    rows = [(step, *box) for step, boxes in enumerate(frames) for box in boxes]
    table = np.array(rows, float).reshape(-1, 5)
    n = len(table)
    return Objects(
        table[:, 0].astype(np.int64), np.full(n, label), np.full(n, -1), table[:, 4],
        center_m=np.column_stack([table[:, 1:3], np.zeros(n)]), size_lwh_m=np.tile([4.0, 2.0, 1.5], (n, 1)),
        yaw_rad=table[:, 3], num_points=None if points is None else np.array(points),
    )  # fmt: skip


def score(truth: Objects, estimates: Objects, match: Match | None = None) -> dict[tuple[str, str], Score]:
    profile = WaymoProfile() if match is None else WaymoProfile().with_match(match)
    steps = 1 + int(max(truth.step.max(initial=0), estimates.step.max(initial=0)))
    sequence = Sequence("one", Steps.of_one_stream(steps), truth, estimates)
    return {(row.metric, row.slice): row for row in profile.scores(profile.measure(sequence), "all")}


def test_a_perfect_result_and_a_turned_one() -> None:
    truth = side([[(10, 0, 0, 1)], [(20, 5, 0, 1)]])
    found = score(truth, side([[(10, 0, 0, 0.9)], [(20, 5, 0, 0.9)]]))
    assert (found["ap", "all"].value, found["aph", "all"].value) == (pytest.approx(1), pytest.approx(1))
    turned = score(truth, side([[(10, 0, math.pi, 0.9)], [(20, 5, 0, 0.9)]]))
    assert (turned["ap", "all"].value, turned["aph", "all"].value) == (pytest.approx(1), pytest.approx(0.5))


def test_results_that_are_no_boxes_are_false_alarms() -> None:
    """Nowhere, and with a score that isn't a number; each counts beside the hit, at every cutoff up to its score."""
    truth = side([[(10, 0, 0, 1)]])
    for bad in ((math.nan, 0, 0, 0.9), (20.0, 0, 0, math.nan)):
        found = score(truth, side([[(10, 0, 0, 0.5), bad]]))
        counts = found["ap", "all"].counts
        assert (found["ap", "all"].value, counts["fp"], counts["invalid_estimates"]) == (pytest.approx(0.5), 1, 1)
    assert score(truth, side([[(10, 0, 0, 0.5), (20, 0, 0, math.nan)]]))["ap", "all, 0-30 m"].value == pytest.approx(
        0.5
    )
    assert score(truth, side([[(10, 0, 0, 0.5), (math.nan, 0, 0, 0.1)]]))["ap", "all"].value == pytest.approx(1)


def test_scores_outside_0_to_1_are_remarked() -> None:
    truth, found = side([[(10, 0, 0, 1)]]), side([[(10, 0, 0, -2.0), (20, 0, 0, 3.0), (30, 0, 0, 1.0)]])
    for profile, num in ((WaymoProfile(), 1), (Av2Detection(), 0)):
        remarks = Remarks(profile, "mine")
        assert len(list(remarks.watch([Sequence("one", Steps.of_one_stream(1), truth, found)]))) == 1
        assert sum("2 of 3 results have scores outside 0 to 1" in line for line in remarks.lines()) == num


def test_levels_and_points() -> None:
    """Three objects: with many points, with five, and with none, which doesn't count; the second is missed."""
    truth = side([[(10, 0, 0, 1), (20, 0, 0, 1), (30, 0, 0, 1)]], points=[100, 5, 0])
    found = score(truth, side([[(10, 0, 0, 0.9)]]))
    assert found["ap", "all, level 1"].value == pytest.approx(1)
    assert found["ap", "all"].value == pytest.approx(0.5)
    assert dict(found["ap", "all"].counts)["fn"] == 1
    assert found["ap", "all, 0-30 m"].value == pytest.approx(0.5)
    assert found["ap", "all, from 50 m"].value is None


def test_the_area_under_a_curve() -> None:
    """Precision 1 to recall 0.5, then 0.6 at recall 1: between them it counts as 0.6 down to a step above 0.5."""
    area = average_precision(np.array([1.0, 0.6]), np.array([0.5, 1.0]))
    assert area == pytest.approx(0.5 + 0.6 * 0.45 + 0.05 * 0.8)
    assert average_precision(np.array([1.0]), np.array([0.0])) == 0


def test_longitudinal_tolerance_by_hand() -> None:
    """Seen from (1.43, 0, 2.18): along the line of sight the box is where it should be, half of the tolerance off."""
    camera, center = np.array([1.43, 0.0, 2.18]), np.array([41.43, 0.0, 2.18])
    for error, apl in ((0.0, 1.0), (2.0, 0.5), (-3.0, 0.25), (4.1, 0.0)):
        moved = center + np.array([error, 0, 0])
        sides = [side([[(0, 0, 0, 0.9)]]) for _ in range(2)]
        truth, found = (
            Objects(o.step, o.label, o.track_id, o.score, center_m=c[None], size_lwh_m=o.size_lwh_m, yaw_rad=o.yaw_rad)
            for o, c in zip(sides, (center, moved), strict=True)
        )
        rows = score(truth, found, Match("let", 0.5))
        assert rows["let_apl", "all"].value == pytest.approx(apl)
        assert rows["let_ap", "all"].value == pytest.approx(1.0 if apl else 0.0)
    assert camera[0] + 40 == center[0]  # 10 % of 40 m are tolerated


def test_let_is_a_match_of_its_own() -> None:
    """From the body's origin, 40 m away: 3.9 m too far still overlap, 4.1 m don't; aside, nothing is tolerated."""
    truth = side([[(40, 0, 0, 1)]])
    for x, y, expected in ((43.9, 0, 1.0), (36.1, 0, 1.0), (44.1, 0, 0.0), (40, 1, 1 / 3), (40.2, 2.5, 0.0)):
        pairs = blocks(truth, side([[(x, y, 0, 1)]]), 1, "let")
        assert pairs.values[0] == pytest.approx(expected, abs=5e-3)  # It moves a little aside, too
    assert str(Match.parse("let:0.3")) == "let 0.3"
    near = blocks(side([[(2, 0, 0, 1)]]), side([[(2.4, 0, 0, 1)]]), 1, "let")
    assert near.values[0] == pytest.approx(1)  # 0.5 m at least


def test_other_matches() -> None:
    assert WaymoProfile().with_match(Match("iou3d", 0.3)).classes[0].overlap == 0.3
    assert [c.overlap for c in WaymoProfile().with_match(Match("let", 0.5)).classes] == [0.5, 0.3, 0.3, 0.3]
    assert [c.overlap for c in WaymoProfile().with_match(Match("let", 0.4)).classes] == [0.4] * 4
    with pytest.raises(ConfigError, match="can't match by bev"):
        WaymoProfile().with_match(Match("bev", 2.0))


SMALL = st.tuples(st.floats(-3, 3), st.floats(-1, 1), st.just(0.0), st.sampled_from([0.125, 0.5, 0.875]))


def overlap(a: Box, b: Box) -> float:
    """Of boxes along the axes, of 4 x 2 m."""
    shared = max(4 - abs(a[0] - b[0]), 0) * max(2 - abs(a[1] - b[1]), 0)
    return shared / (16 - shared)


@settings(max_examples=30, deadline=None)
@given(st.lists(SMALL, min_size=1, max_size=3), st.lists(SMALL, max_size=3))
def test_counts_are_those_of_the_best_of_all_matches(truth: list[Box], said: list[Box]) -> None:
    """An oracle of its own: every assignment is tried."""
    profile = WaymoProfile().with_match(Match("iou3d", 0.3))
    sequence = Sequence("one", Steps.of_one_stream(1), side([truth]), side([said]))
    counts = profile.measure(sequence).curves["vehicle", "", 2]
    for cutoff in (0.0, 0.3, 0.6, 0.9):
        held = [box for box in said if box[3] >= cutoff]
        best = (-1.0, 0)
        for places in itertools.product([None, *range(len(held))], repeat=len(truth)):
            used = [p for p in places if p is not None]
            if len(used) == len(set(used)):
                each = [overlap(t, held[p]) for t, p in zip(truth, places, strict=True) if p is not None]
                if all(value >= 0.3 for value in each):
                    best = max(best, (sum(each), len(each)))
        k = int(np.flatnonzero(np.isclose(CUTOFFS, cutoff))[0])
        assert (counts.hits[k], counts.alarms[k], counts.misses[k]) == (
            best[1], len(held) - best[1], len(truth) - best[1]
        )  # fmt: skip
