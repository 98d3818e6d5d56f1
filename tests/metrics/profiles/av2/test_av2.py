"""The profiles `av2` and `av2-tracking`: av2-api's own numbers, and cases by hand."""

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.metrics.profiles.av2.oracles.av2_logs import PLANS, Log, Row, logs_of

from fbench.metrics.profiles.av2.boxes import CLASSES
from fbench.metrics.profiles.av2.detection import Av2Detection, average_precision
from fbench.metrics.profiles.av2.tracking import Av2Tracking
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.remarks import lines
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import text_array
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps

FROZEN = json.loads((Path(__file__).parent / "oracles" / "av2_metrics.json").read_text())


def objects(rows: Iterable[Row]) -> Objects:
    rows = list(rows)
    n = len(rows)
    return Objects(
        step=np.array([r["step"] for r in rows], np.int64),
        label=text_array([r["name"] for r in rows]),
        track_id=np.array([r["id"] for r in rows], np.int64),
        score=np.array([r["score"] for r in rows], float),
        center_m=np.array([r["xyz"] for r in rows], float).reshape(n, 3),
        size_lwh_m=np.array([r["lwh"] for r in rows], float).reshape(n, 3),
        yaw_rad=np.array([r["yaw"] for r in rows], float),
        num_points=np.array([r["points"] for r in rows], np.int64),
    )


def of_log(log: Log) -> Sequence:
    zeros = np.zeros(log.num_steps, np.int64)
    return Sequence(log.name, Steps(np.arange(log.num_steps), zeros, zeros), objects(log.truth), objects(log.results))


def box(x: float, score: float = 0.5, step: int = 0, own: int = 0, **changes: Any) -> Row:
    plain: Row = {
        "step": step, "name": "bus", "id": own, "xyz": (x, 0.0, 0.0), "lwh": (4.0, 2.0, 1.5), "yaw": 0.0, "points": 5,
        "score": score,
    }  # fmt: skip
    return {**plain, **changes}


def score(truth: list[Row], results: list[Row], profile: Any = None, num_steps: int = 1) -> list[Score]:
    profile = profile or Av2Detection()
    return profile.scores(profile.measure(of_log(Log("log", num_steps, truth, results))), "all")


def find(rows: list[Score], metric: str, class_: str = "all", matching: str | None = None) -> Score:
    found = [r for r in rows if r.metric == metric and r.class_ == class_ and matching in (None, r.matching)]
    assert len(found) == 1, (metric, class_, matching)
    return found[0]


@pytest.mark.parametrize("plan", PLANS)
def test_detection_is_av2_apis(plan: str) -> None:
    profile = Av2Detection()
    rows = profile.scores(evaluate(profile, [of_log(log) for log in logs_of(PLANS[plan])]).total, "all")
    theirs = FROZEN["detection"][plan]
    names = {"cds": "CDS", "map": "AP", "mate": "ATE", "mase": "ASE", "maoe": "AOE"}
    for ours, name in names.items():
        assert find(rows, ours).value == pytest.approx(theirs["metrics"]["AVERAGE_METRICS"][name], abs=1e-9)
    for class_ in PLANS[plan].classes:
        own = theirs["metrics"][class_.upper()]
        for ours, name in {"cds": "CDS", "mean_dist_ap": "AP", "ate": "ATE", "ase": "ASE", "aoe": "AOE"}.items():
            row = find(rows, ours, class_)
            if not row.counts["gt"]:
                why = f"no truth boxes (av2-api prints {own[name]:.4g})"
                assert (row.value, row.reason) == (None, why), (class_, name)
            else:
                assert row.value == pytest.approx(own[name], abs=1e-9), (class_, name)
        hits = theirs["hits"].get(class_.upper(), [0, 0, 0, 0])
        assert [find(rows, "ap", class_, f"center3d {m:g} m").counts["tp"] for m in (0.5, 1, 2, 4)] == hits


@pytest.mark.parametrize("plan", FROZEN["tracking"])
def test_tracking_is_av2_apis(plan: str) -> None:
    profile = Av2Tracking()
    rows = profile.scores(evaluate(profile, [of_log(log) for log in logs_of(PLANS[plan])]).total, "all")
    theirs = FROZEN["tracking"][plan]
    for class_ in PLANS[plan].classes:
        name = class_.upper()
        hota = find(rows, "hota", class_)
        if not hota.counts["gt"]:
            assert (hota.value, hota.reason) == (None, "no truth boxes")
            continue
        assert hota.counts["score"] == pytest.approx(theirs["HOTA"]["thresholds"][name], abs=1e-12)
        assert hota.value == pytest.approx(theirs["HOTA"]["best"][name], abs=1e-9)
        assert find(rows, "hota_mean", class_).value == pytest.approx(theirs["HOTA"]["mean"][name], abs=1e-9)
        assert find(rows, "best_mota", class_).value == pytest.approx(theirs["MOTA"]["best"][name], abs=1e-9)
        assert find(rows, "amota", class_).value == pytest.approx(theirs["MOTA"]["mean"][name], abs=1e-9)
        own = theirs["at_best"][name]
        no_matches = {key for key in ("AssA", "LocA") if not own["DetA"]} | ({"MOTP"} if not own["CLR_TP"] else set())
        undefined = dict.fromkeys(no_matches, "no matches")
        if not own["CLR_TP"] + own["CLR_FP"]:
            undefined["CLR_Pr"] = "no results"
        for key, value in own.items():
            row = find(rows, key.lower(), class_)
            if key in undefined:
                assert (row.value, row.reason) == (None, f"{undefined[key]} (TrackEval prints {value:g})"), class_
            else:
                assert row.value == pytest.approx(value, abs=1e-9), (class_, key)


def test_a_result_takes_the_nearest_truth_however_far_off() -> None:
    # The better score is 3 m off, and takes the box; the one at the very place comes too late.
    rows = score([box(10.0)], [box(13.0, 0.9), box(10.0, 0.8)])
    assert [find(rows, "ap", "bus", f"center3d {m:g} m").counts["tp"] for m in (0.5, 1, 2, 4)] == [0, 0, 0, 1]
    # Each looks at its nearest box only: the second box stays unmatched, though it is 1.5 m off.
    rows = score([box(10.0), box(12.0)], [box(10.2, 0.9), box(10.5, 0.8)])
    assert find(rows, "ap", "bus", "center3d 2 m").counts == {"gt": 2, "tp": 1, "fp": 1, "fn": 1}


@pytest.mark.parametrize("profile", [Av2Detection(), Av2Tracking()])
def test_the_table_has_the_classes_that_are_there(profile: Any) -> None:
    rows = score([box(10.0)], [box(10.0), box(30.0, own=1, name="dog")], profile)
    assert {row.class_ for row in rows} == {"all", *CLASSES}

    def columns(rows: list[Score]) -> set[str]:
        return {name for line in lines(rows, profile.facts.headlines) for name in line.scores}

    assert columns(rows) == {"all", "bus", "dog"}
    assert columns([row for row in rows if row.class_ == "bollard"]) == {"bollard"}  # alone, as with --class


def test_velocities_count_for_nothing() -> None:
    # The challenge's boxes have none, so a perfect box is perfect whatever its velocity is.
    for profile in (Av2Detection(), Av2Tracking()):
        log = of_log(Log("log", 1, [box(10.0)], [box(10.0)]))
        rushing = replace(log, estimates=replace(log.estimates, velocity_mps=np.full((1, 3), np.inf)))
        plain, same = (profile.scores(profile.measure(own), "all") for own in (log, rushing))
        assert [row.value for row in same] == [row.value for row in plain]
        assert find(same, "map" if profile.name == "av2" else "hota").counts["invalid"] == 0


def test_precision_over_recall_by_hand() -> None:
    # Hit, false alarm, hit of two: precision 1 to recall 0.5, then from 1 to 2/3 in a line, at 101 recalls.
    line = [1.0] * 51 + [1.0 + (2 / 3 - 1.0) * k / 50 for k in range(1, 51)]
    # Between the recalls 0.5 (twice, interpolated from the later one) and 1 the best precision beyond is 2/3.
    found = average_precision(np.array([True, False, True]), 2)
    steps = [1.0] * 50 + [2 / 3] * 51
    assert found == pytest.approx(np.mean(steps), abs=1e-12)
    assert found != pytest.approx(np.mean(line))
    assert average_precision(np.array([True]), 2) == pytest.approx(51 / 101)


def test_errors_and_composite_score_by_hand() -> None:
    # 1 m ahead and as high above: sqrt 2; extents 4 2 1.5 against 2 2 3: 6 / 24; half a turn less 0.1 rad.
    off = box(11.0, xyz=(11.0, 0.0, 1.0), lwh=(2.0, 2.0, 3.0), yaw=np.pi + 0.1)
    rows = score([box(10.0)], [off])
    assert find(rows, "ate", "bus").value == pytest.approx(math.sqrt(2))
    assert find(rows, "ase", "bus").value == pytest.approx(0.75)
    assert find(rows, "aoe", "bus").value == pytest.approx(np.pi - 0.1)
    ap = 0.5  # at 2 m and 4 m of four distances
    quality = (1 - math.sqrt(2) / 2 + 0.25 + 0.1 / np.pi) / 3
    assert find(rows, "cds", "bus").value == pytest.approx(ap * quality)
    assert find(rows, "cds").value == pytest.approx(ap * quality / len(CLASSES))
    assert find(rows, "map").counts["classes_without_truth"] == len(CLASSES) - 1


def test_what_does_not_count_is_counted() -> None:
    truth = [box(10.0), box(150.0), box(20.0, points=0), box(30.0, name="railed_vehicle")]
    rows = score(truth, [box(10.0), box(149.9, 0.4), box(150.0), box(5.0, name="unicorn"), box(float("nan"), 0.9)])
    counts = find(rows, "map").counts
    assert (counts["gt"], counts["estimates"]) == (1, 3)
    assert (counts["out_of_range"], counts["out_of_range_truth"]) == (1, 1)
    assert (counts["unknown_class"], counts["unknown_class_truth"], counts["no_points_truth"]) == (1, 1, 1)
    assert counts["invalid"] == 1  # and a false positive, the first by its score
    assert find(rows, "ap", "bus", "center3d 2 m").value == pytest.approx((100 * 0.5 + 1 / 3) / 101)


def test_tracks_that_are_the_truth_are_perfect_and_nothing_is_said_of_no_truth() -> None:
    truth = [box(10.0 + step, step=step) for step in range(4)]
    rows = score(truth, truth, Av2Tracking(), 4)
    assert [find(rows, m, "bus").value for m in ("hota", "mota", "motp", "amota", "best_mota")] == [1, 1, 1, 1, 1]
    assert find(rows, "hota", "dog").value is None
    assert find(score([], truth, Av2Tracking(), 4), "hota").reason == "no truth boxes"
    # 1.2 m off is below a similarity of 0.5: not a match for CLEAR, but for 8 of HOTA's 19 thresholds, 0.05 to 0.4.
    moved = [box(11.2 + step, step=step) for step in range(4)]
    rows = score(truth, moved, Av2Tracking(), 4)
    assert find(rows, "hota", "bus").value == pytest.approx(8 / 19)
    assert find(rows, "mota", "bus").value == -1.0
    assert find(rows, "best_mota", "bus").value == 0.0


@pytest.mark.parametrize("profile", [Av2Detection(), Av2Tracking()])
def test_numbers_do_not_depend_on_where_the_ego_is(profile: Any) -> None:
    log = of_log(logs_of(PLANS["usual"])[0])
    shift = np.array([1000.0, -500.0, 20.0])
    sides = (replace(side, center_m=np.asarray(side.center_m) + shift) for side in (log.truth, log.estimates))
    truth, estimates = sides
    moved = replace(log, truth=truth, estimates=estimates, ego_m=np.tile(shift, (len(log.steps), 1)))
    one, other = (profile.scores(profile.measure(own), "all") for own in (log, moved))
    for row, same in zip(one, other, strict=True):
        assert row.value == (None if same.value is None else pytest.approx(same.value, abs=1e-9))


def test_bad_input_is_said() -> None:
    with pytest.raises(ConfigError, match="center distance"):
        Av2Detection().with_match(Match("iou3d", 0.5))
    with pytest.raises(ConfigError, match="center distance"):
        Av2Tracking().with_match(Match("center3d", 2.0))
    with pytest.raises(MetricError, match="without an id"):
        score([box(1.0, own=-1)], [box(1.0)], Av2Tracking())
    with pytest.raises(MetricError, match="id 3 twice"):
        score([box(1.0)], [box(1.0, own=3), box(2.0, own=3)], Av2Tracking())
    flat = Objects(np.zeros(1, np.int64), np.array(["bus"]), np.zeros(1, np.int64), np.ones(1), np.ones((1, 4)))
    steps = Steps.of_one_stream(1)
    with pytest.raises(MetricError, match="place in space"):
        Av2Detection().measure(Sequence("log", steps, flat, flat))
