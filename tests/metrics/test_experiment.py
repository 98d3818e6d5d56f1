"""The thesis's tables, by hand."""

import pytest

from fbench.metrics.experiment import (
    accuracy_table,
    condition_table,
    configurations,
    disturbance_table,
    gain_table,
    latency_table,
    robustness_table,
)
from fbench.metrics.robustness.scenes import ScoredRun
from fbench.replay.data.scores import Score

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
    names = ["thesis/late2d", "mine", "thesis/early3d-stereo", "thesis/early3d", "late3d"]
    expected = ["late3d", "thesis/early3d", "thesis/early3d-stereo", "thesis/late2d", "mine"]
    assert configurations([ScoredRun(name, "clear", "urban-1", []) for name in names]) == expected


def test_accuracy_is_that_of_clear_weather():
    table = accuracy_table(RUNS)
    assert [(line.name, line.space) for line in table.lines] == [
        ("camera2d", "image"), ("late3d", "image"), ("mine", "image"), ("late3d", "3D"),
    ]  # fmt: skip
    f1, mota, without, truth = table.lines[1].figures
    assert f1.value == pytest.approx(0.8)
    assert mota.value == pytest.approx((10 - 2 - 2 - 1) / 10)
    assert without.value == pytest.approx(0.7)
    assert truth.value == 10


def test_a_figure_of_the_thesis_stands_beside_the_space_of_the_configurations_boxes_alone():
    table = accuracy_table(RUNS)
    published = {
        (line.name, line.space): [figure.published for figure in line.figures]
        for line in table.lines if any(figure.published is not None for figure in line.figures)
    }  # fmt: skip
    assert published == {
        ("camera2d", "image"): [pytest.approx(0.6824), None, pytest.approx(0.6143), None],
        ("late3d", "3D"): [pytest.approx(0.8358), None, pytest.approx(0.8266), None],
    }
    assert any("beside the space of the configuration's own boxes alone" in note for note in table.notes)
    assert not any("thesis has one figure" in note for note in accuracy_table([RUNS[0]]).notes)


def test_each_sensor_alone_stands_beside_both_its_configurations_and_stereo_has_none():
    both = scores(8, 2, 2, "image") + scores(9, 1, 1, "3D")
    names = ["lidar2d", "lidar3d", "radar2d", "radar3d", "thesis/early3d", "thesis/early3d-stereo"]
    table = accuracy_table([ScoredRun(name, "clear", "urban-1", both) for name in names])
    found = {(line.name, line.space): line.figures[0].published for line in table.lines}
    assert {key: value for key, value in found.items() if value is not None} == {
        ("lidar2d", "image"): pytest.approx(0.7151), ("lidar3d", "3D"): pytest.approx(0.7151),
        ("radar2d", "image"): pytest.approx(0.6766), ("radar3d", "3D"): pytest.approx(0.6766),
        ("thesis/early3d", "3D"): pytest.approx(0.8071),
    }  # fmt: skip


def test_robustness_leaves_clear_out():
    table = robustness_table(RUNS, ["clear", "fog"])
    assert [column.name for column in table.columns] == ["fog"]
    camera, fused, mine, fused3d = (line.figures[0] for line in table.lines)
    assert camera.value == pytest.approx((1 / 5.5) / (5 / 7.5) - 1)
    assert camera.published == pytest.approx(-0.3764)
    assert fused.value == pytest.approx((6 / 9) / 0.8 - 1)
    assert (fused3d.value, fused3d.published) == (0, pytest.approx(-0.1041))
    assert fused.published is None
    assert (mine.value, mine.reason) == (None, "no scene was run both in clear and in fog")
    assert table.reasons == ("fog of mine image: no scene was run both in clear and in fog",)


def test_f1_by_condition():
    table = condition_table(RUNS, ["clear", "fog"])
    assert [f.value for f in table.lines[0].figures] == [pytest.approx(5 / 7.5), pytest.approx(1 / 5.5)]


def test_latency_is_the_median_over_all_runs():
    runs = [{"track": [1 * MS, 2 * MS], "total": [5 * MS, 6 * MS]}, {"track": [3 * MS]}]
    table = latency_table({"lidar3d": runs, "camera2d": [{"total": [7 * MS]}], "radar3d": [{"total": []}]})
    assert [line.name for line in table.lines] == ["track", "total"]
    assert [column.name for column in table.columns] == ["lidar3d", "camera2d", "radar3d"]
    assert [f.value for f in table.lines[0].figures] == [2.0, None, None]
    assert [f.value for f in table.lines[1].figures] == [5.0, 7.0, None]
    assert [f.reason for f in table.lines[1].figures] == [None, None, "no frame is left"]


def test_no_runs_give_empty_tables():
    assert accuracy_table([]).lines == robustness_table([], ["clear", "fog"]).lines == ()


def many(configuration, hits, condition="clear", space="image"):
    """A run a scene, each of ten truth boxes, so many of which are found."""
    return [
        ScoredRun(configuration, condition, f"urban-{seed}", scores(tp, 0, 10 - tp, space))
        for seed, tp in enumerate(hits)
    ]


def test_intervals_are_over_scenes_and_paired():
    """Each scene loses half of its hits in fog: so does every resample of scenes whose F1 is alike."""
    runs = many("camera2d", [8] * 6) + many("camera2d", [4] * 6, "fog")
    f1 = accuracy_table(runs).lines[0].figures[0]
    assert (f1.low, f1.high) == (f1.value, f1.value)
    fog = robustness_table(runs, ["clear", "fog"]).lines[0].figures[0]
    assert fog.low == fog.high == pytest.approx(fog.value)
    spread = accuracy_table(many("camera2d", [2, 4, 6, 8, 10, 10])).lines[0].figures[0]
    assert spread.low < spread.value < spread.high
    assert accuracy_table(many("camera2d", [2, 4, 6, 8, 10, 10])).lines[0].figures[0] == spread


def test_fewer_than_five_scenes_have_no_interval_and_a_note_says_so():
    table = accuracy_table(many("camera2d", [8, 6, 4, 2]))
    assert table.lines[0].figures[0].low is None
    assert "No intervals where there are fewer than 5 scenes: clear (4)." in table.notes


def test_gains_are_those_over_the_best_input_and_say_what_is_not_significant():
    runs = [
        *many("camera2d", [5] * 6), *many("lidar2d", [6] * 6), *many("radar2d", [1] * 6),
        *many("early2d", [8] * 6), *many("late2d", [5, 7, 5, 7, 5, 7]),
    ]  # fmt: skip
    table = gain_table(runs, ["clear"])
    found = {line.name: line.figures[0] for line in table.lines}
    assert list(found) == ["early2d over lidar2d", "late2d over lidar2d", "early2d over late2d"]
    assert found["early2d over lidar2d"].value == pytest.approx(8 / 9 - 6 / 8)
    assert found["late2d over lidar2d"].value == pytest.approx(36 / 48 - 6 / 8)
    (level,) = [note for note in table.notes if note.startswith("Not significant")]
    assert level == "Not significant, as the interval holds 0: late2d over lidar2d, image (clear)."


def test_stereo_is_compared_with_the_same_fusion_without():
    runs = [*many("early3d", [8] * 5, space="3D"), *many("early3d-stereo", [7] * 5, space="3D")]
    (line,) = gain_table(runs, ["clear"]).lines
    assert (line.name, line.space) == ("early3d-stereo over early3d", "3D")
    assert line.figures[0].high < 0


def test_tables_of_the_region_have_names_of_their_own():
    assert accuracy_table(RUNS, region=True).name == "accuracy_region"
    assert robustness_table(RUNS, ["clear", "fog"], region=True).title.endswith("road and sidewalk only, %")


def test_disturbances_are_compared_with_the_same_drives_undisturbed():
    runs = [
        ScoredRun("late3d", name, f"urban-{scene}", scores(tp, 0, 10 - tp, "3D"))
        for scene in range(5)
        for name, tp in (("clear", 8), ("lidar lost", 4 if scene else 8))
    ]
    table = disturbance_table(runs, ["clear", "lidar lost"], ["As said."])
    assert (table.name, [column.name for column in table.columns]) == ("disturbances", ["lidar lost"])
    ((line),) = table.lines
    (figure,) = line.figures
    clear, lost = 2 * 40 / (2 * 40 + 10), 2 * 24 / (2 * 24 + 26)
    assert figure.value == pytest.approx((lost - clear) / clear)
    assert figure.low is not None
    assert figure.low <= figure.value <= figure.high
    assert "As said." in table.notes
