"""The thesis's tables, by hand."""

import pytest

from fbench.metrics.experiment import (
    accuracy_table,
    condition_table,
    configurations,
    latency_table,
    robustness_table,
)
from fbench.metrics.robustness import ScoredRun
from fbench.replay.scores import Score

SPACES = {"image": "iou 0.5, within 50 m", "3D": "bev 2 m, within 50 m"}
MS = 1_000_000


def scores(tp, fp, fn, space):
    gt, counts = tp + fn, {"tp": tp, "fp": fp, "fn": fn}
    tracks = {**counts, "gt": gt, "idsw": 1}
    of = ("vehicle", "all", SPACES[space])
    return [
        Score("f1", *of, tp / (tp + fp / 2 + fn / 2), None, "1", counts),
        Score("mota", *of, (gt - fn - fp - 1) / gt, None, "1", tracks),
        Score("mota_no_fp", *of, (gt - fn - 1) / gt, None, "1", tracks),
    ]


RUNS = [
    ScoredRun("mine", "clear", "urban-1", scores(5, 0, 5, "image")),
    ScoredRun("late3d", "clear", "urban-1", scores(8, 2, 2, "image") + scores(9, 1, 1, "3D")),
    ScoredRun("late3d", "fog", "urban-1", scores(6, 2, 4, "image") + scores(9, 1, 1, "3D")),
    ScoredRun("camera2d", "clear", "urban-1", scores(5, 0, 5, "image")),
    ScoredRun("camera2d", "fog", "urban-1", scores(1, 0, 9, "image")),
]


def test_configurations_come_in_the_order_of_the_thesis_and_others_last():
    assert configurations(RUNS) == ["camera2d", "late3d", "mine"]


def test_accuracy_is_that_of_clear_weather():
    table = accuracy_table(RUNS)
    assert [(line.name, line.space) for line in table.lines] == [
        ("camera2d", "image"), ("late3d", "image"), ("mine", "image"), ("late3d", "3D"),
    ]  # fmt: skip
    f1, mota, without, truth = table.lines[1].figures
    assert (f1.value, f1.published) == (pytest.approx(0.8), pytest.approx(0.8358))
    assert (mota.value, mota.published) == (pytest.approx((10 - 2 - 2 - 1) / 10), None)
    assert (without.value, without.published) == (pytest.approx(0.7), pytest.approx(0.8266))
    assert truth.value == 10
    assert table.lines[2].figures[0].published is None


def test_robustness_leaves_clear_out():
    table = robustness_table(RUNS, ["clear", "fog"])
    assert [column.name for column in table.columns] == ["fog"]
    camera, fused, mine, fused3d = (line.figures[0] for line in table.lines)
    assert camera.value == pytest.approx((1 / 5.5) / (5 / 7.5) - 1)
    assert camera.published == pytest.approx(-0.3764)
    assert fused.value == pytest.approx((6 / 9) / 0.8 - 1)
    assert fused3d.value == 0
    assert (mine.value, mine.reason) == (None, "no scene was run both in clear and in fog")
    assert table.reasons == ("fog of mine image: no scene was run both in clear and in fog",)


def test_f1_by_condition():
    table = condition_table(RUNS, ["clear", "fog"])
    assert [f.value for f in table.lines[0].figures] == [pytest.approx(5 / 7.5), pytest.approx(1 / 5.5)]


def test_latency_is_the_median_without_each_runs_first():
    runs = [{"track": [900 * MS, 1 * MS, 2 * MS], "total": [950 * MS, 5 * MS, 6 * MS]}, {"track": [800 * MS, 3 * MS]}]
    table = latency_table({"lidar3d": runs, "camera2d": [{"total": [1, 7 * MS]}]})
    assert [line.name for line in table.lines] == ["track", "total"]
    assert [column.name for column in table.columns] == ["lidar3d", "camera2d"]
    assert [f.value for f in table.lines[0].figures] == [2.0, None]
    assert [f.value for f in table.lines[1].figures] == [5.0, 7.0]


def test_no_runs_give_empty_tables():
    assert accuracy_table([]).lines == robustness_table([], ["clear", "fog"]).lines == ()
