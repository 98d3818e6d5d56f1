"""Detection scores of runs whose counts can be told by hand."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera, write_run

from fbench.metrics.runs.detection import Detection
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import FrameEntry

OPTIONS = ScoreOptions()
NOTHING3D, NOTHING2D = Boxes3D.empty(), Boxes2D.empty()


def scores(run: Run, options: ScoreOptions = OPTIONS, class_: str = "vehicle", space: str = "bev") -> dict[str, Score]:
    """Rows of one class in one space, by metric."""
    rows = Detection().scores(run, options)
    return {r.metric: r for r in rows if (r.class_, r.slice) == (class_, "all") and r.matching.startswith(space)}


def counts(run: Run, **where: Any) -> tuple[float, ...]:
    """(tp, fp, fn, ignored)."""
    c = scores(run, **where)["f1"].counts
    return c["tp"], c["fp"], c["fn"], c["ignored"]


def values(run: Run, **where: Any) -> dict[str, float | None]:
    rows = scores(run, **where)
    return {name: rows[name].value for name in ("f1", "precision", "recall")}


def test_hit_miss_and_false_alarm(make_run: MakeRun) -> None:
    run = make_run(Case(boxes3d((10, 0), (30, 5)), boxes3d((10.5, 0), (20, 0), label="car")))
    assert counts(run) == (1, 1, 1, 0)
    assert values(run) == {"f1": 0.5, "precision": 0.5, "recall": 0.5}


def test_f1_of_unequal_precision_and_recall(make_run: MakeRun) -> None:
    run = make_run(Case(boxes3d((10, 0)), boxes3d((10, 0), (20, 0), (30, 0), label="car")))
    assert values(run) == {"precision": 1.0, "recall": pytest.approx(1 / 3), "f1": pytest.approx(0.5)}


def test_a_second_estimate_on_one_truth_is_a_false_alarm(make_run: MakeRun) -> None:
    assert counts(make_run(Case(boxes3d((10, 0), (10.2, 0)), boxes3d((10, 0), label="car")))) == (1, 1, 0, 0)


def test_predictions_of_a_tracker_are_counted_among_what_counts(make_run: MakeRun) -> None:
    found = replace(boxes3d((10, 0), (20, 0), (30, 0), (400, 0)), predicted=np.array([True, False, True, True]))
    run = make_run(Case(found, boxes3d((10, 0), (20, 0), label="car")), Case(boxes3d((10, 0)), boxes3d((10, 0))))
    assert counts(run) == (3, 1, 0, 1)
    assert {scores(run)[name].counts["predicted"] for name in ("f1", "precision", "recall")} == {2}


def test_where_nothing_is_predicted_nothing_is_said_of_it(make_run: MakeRun) -> None:
    found = replace(boxes3d((10, 0)), predicted=np.array([False]))
    assert "predicted" not in scores(make_run(Case(found, boxes3d((10, 0), label="car"))))["f1"].counts


def test_the_threshold_is_included(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), label="car")
    assert counts(make_run(Case(boxes3d((12, 0)), truth))) == (1, 0, 0, 0)
    assert counts(make_run(Case(boxes3d((12.001, 0)), truth))) == (0, 1, 1, 0)
    wide = ScoreOptions(distance_m=3.0)
    assert counts(make_run(Case(boxes3d((12.001, 0)), truth)), options=wide) == (1, 0, 0, 0)


def test_counts_are_summed_over_frames_before_dividing(make_run: MakeRun) -> None:
    car = boxes3d((10, 0), label="car")
    run = make_run(Case(car, car), Case(boxes3d((30, 0), (40, 0), (20, 0)), car))
    assert counts(run) == (1, 3, 1, 0)
    assert values(run)["precision"] == 0.25


class TestEmpty:
    def test_nothing_at_all_is_undefined(self, make_run: MakeRun) -> None:
        found = scores(make_run(Case(NOTHING3D, NOTHING3D)))
        assert {r.value for r in found.values()} == {None}
        assert {m: r.reason for m, r in found.items()} == {
            "f1": "no truth and no estimates",
            "precision": "no estimates",
            "recall": "no truth boxes",
            "best_f1": "no truth boxes",
            "best_f1_threshold": "no truth boxes",
            "ap": "no truth boxes",
            "horizon_50": "no truth boxes",
            "horizon_80": "no truth boxes",
            "horizon_90": "no truth boxes",
        }

    def test_estimates_without_truth_boxes_are_false_alarms(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes3d((10, 0)), NOTHING3D))
        assert counts(run) == (0, 1, 0, 0)
        assert values(run) == {"f1": 0.0, "precision": 0.0, "recall": None}

    def test_truth_without_estimates_is_missed(self, make_run: MakeRun) -> None:
        run = make_run(Case(NOTHING3D, boxes3d((10, 0), label="car")))
        assert counts(run) == (0, 0, 1, 0)
        assert values(run) == {"f1": 0.0, "precision": None, "recall": 0.0}

    def test_a_log_without_truth_gives_the_same_rows_as_null(self, make_run: MakeRun) -> None:
        car = boxes3d((10, 0), label="car")
        with_truth = Detection().scores(make_run(Case(boxes3d((10, 0)), car)), OPTIONS)
        without = Detection().scores(make_run(Case(boxes3d((10, 0)))), OPTIONS)
        name = [(r.metric, r.class_, r.matching) for r in with_truth if r.slice == "all"]
        assert name == [(r.metric, r.class_, r.matching) for r in without]
        assert {r.reason for r in without if "bev" in r.matching and r.metric != "coverage"} == {"no truth"}

    def test_unlabeled_frames_arent_scored_and_coverage_says_so(self, make_run: MakeRun) -> None:
        car = boxes3d((10, 0), label="car")
        run = make_run(Case(car, car), Case(boxes3d((30, 0))), Case(car, car), Case(car))
        assert counts(run) == (2, 0, 0, 0)
        (row,) = [r for r in Detection().scores(run, OPTIONS) if r.metric == "coverage"]
        assert (row.value, row.counts) == (0.5, {"scored": 2, "frames": 4})

    def test_a_rig_without_cameras_has_no_image_scores(self, make_run: MakeRun) -> None:
        car = boxes3d((10, 0), label="car")
        assert scores(make_run(Case(car, car)), space="iou")["f1"].reason == "no cameras"


class TestClasses:
    TRUTH = boxes3d((10, 0), (20, 0), label=["truck", "pedestrian"])

    def test_estimates_without_labels_may_be_any_vehicle_and_are_excused_on_others(self, make_run: MakeRun) -> None:
        assert counts(make_run(Case(boxes3d((10, 0), (20, 0), (30, 0)), self.TRUTH))) == (1, 1, 0, 1)

    def test_the_label_among_vehicles_isnt_compared(self, make_run: MakeRun) -> None:
        assert counts(make_run(Case(boxes3d((10, 0), label="car"), self.TRUTH))) == (1, 0, 0, 0)

    def test_a_vehicle_on_a_pedestrian_is_a_false_alarm(self, make_run: MakeRun) -> None:
        assert counts(make_run(Case(boxes3d((20, 0), label="car"), self.TRUTH))) == (0, 1, 1, 0)

    def test_estimates_of_other_classes_are_left_out(self, make_run: MakeRun) -> None:
        assert counts(make_run(Case(boxes3d((20, 0), label="pedestrian"), self.TRUTH))) == (0, 0, 1, 0)

    def test_single_unlabeled_estimates_of_a_labelling_pipeline_are_agnostic(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes3d((10, 0), (20, 0), label=["", ""]), self.TRUTH))
        assert counts(run) == (1, 0, 0, 1)

    def test_a_labelling_pipeline_has_rows_for_each_label(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (20, 0), (30, 0), label=["car", "car", "pedestrian"])
        run = make_run(Case(boxes3d((10, 0), (20, 0), (40, 0), label=["car", "van", "van"]), truth))
        assert counts(run, class_="car") == (1, 0, 1, 0)
        assert counts(run, class_="van") == (0, 2, 0, 0)
        assert counts(run, class_="pedestrian") == (0, 0, 1, 0)
        assert counts(run) == (2, 1, 0, 0)
        classes = list(dict.fromkeys(r.class_ for r in Detection().scores(run, OPTIONS)))
        assert classes == ["vehicle", "car", "van", "pedestrian", "all"]

    def test_a_pipeline_without_labels_has_none(self, make_run: MakeRun) -> None:
        rows = Detection().scores(make_run(Case(boxes3d((10, 0)), self.TRUTH)), OPTIONS)
        assert {r.class_ for r in rows} == {"vehicle", "all"}


class TestIgnored:
    def test_an_estimate_on_ignored_truth_counts_as_nothing(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (20, 0), label="car", ignore=[False, True])
        assert counts(make_run(Case(boxes3d((10, 0), (20, 0)), truth))) == (1, 0, 0, 1)
        assert counts(make_run(Case(NOTHING3D, truth))) == (0, 0, 1, 0)

    def test_real_truth_goes_before_nearer_ignored_truth(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (11.5, 0), label="car", ignore=[True, False])
        assert counts(make_run(Case(boxes3d((10, 0)), truth))) == (1, 0, 0, 0)

    def test_in_3d_one_ignored_box_excuses_one_estimate(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), label="car", ignore=[True])
        assert counts(make_run(Case(boxes3d((10, 0), (10.5, 0)), truth))) == (0, 1, 0, 1)

    def test_an_ignore_region_without_class_excuses_labeled_estimates(self, make_run: MakeRun) -> None:
        for label, expected in (("other", (0, 0, 0, 1)), ("pedestrian", (0, 1, 0, 0))):
            truth = boxes3d((10, 0), label=label, ignore=[True])
            assert counts(make_run(Case(boxes3d((10, 0), label="car"), truth))) == expected

    def test_in_images_a_region_excuses_all_that_lies_in_it(self, make_run: MakeRun) -> None:
        region = boxes2d((0, 0, 400, 300), label="other", ignore=[True])
        inside, half_out = (10, 10, 30, 30), (390, 10, 410, 30)
        more_out = (391, 50, 411, 70)
        run = make_run(Case(boxes2d(inside, (50, 50, 60, 60), half_out, more_out), truth2d=region))
        assert counts(run, space="iou") == (0, 1, 0, 3)


class TestRegion:
    """Range 50 m; truth and estimates on both sides of it."""

    @pytest.mark.parametrize(
        ("truth_x", "estimate_x", "expected"),
        [
            (50, 50, (1, 0, 0, 0)),
            (49, 50.5, (1, 0, 0, 0)),
            (50.5, 49.5, (0, 0, 0, 1)),
            (51, 51, (0, 0, 0, 1)),
            (40, 51, (0, 0, 1, 1)),
            (55, 49, (0, 1, 0, 0)),
        ],
    )
    def test_borders_cost_nothing(
        self, make_run: MakeRun, truth_x: float, estimate_x: float, expected: tuple[int, ...]
    ) -> None:
        run = make_run(Case(boxes3d((estimate_x, 0)), boxes3d((truth_x, 0), label="car")))
        assert counts(run) == expected

    def test_the_range_is_measured_in_the_ground_plane(self, make_run: MakeRun) -> None:
        run = make_run(Case(NOTHING3D, boxes3d((30, 40), (-30, 40.1), label="car")))
        assert counts(run) == (0, 0, 1, 0)

    def test_an_estimate_inside_goes_before_one_outside(self, make_run: MakeRun) -> None:
        truth = boxes3d((49.5, 0), label="car")
        run = make_run(Case(boxes3d((48, 0), (50.5, 0), score=[0.1, 0.9]), truth))
        assert counts(run) == (1, 0, 0, 1)

    def test_only_what_a_camera_sees_counts(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (-10, 0), (10, 9.9), (10, 10.1), label="car")
        estimates = boxes3d((10, 0), (-10, 0), (-20, 0))
        run = make_run(Case(estimates, truth), rig=front_camera())
        assert counts(run) == (1, 0, 1, 2)
        assert counts(run, options=ScoreOptions(in_view=False)) == (2, 1, 2, 0)

    def test_the_matching_text_names_the_region(self, make_run: MakeRun) -> None:
        car = boxes3d((10, 0), label="car")
        rows = list(Detection().scores(make_run(Case(car, car), rig=front_camera()), OPTIONS))
        assert list(dict.fromkeys(row.matching for row in rows)) == [
            "bev 2 m, within 50 m, in view",
            "iou 0.5, truth projected from 3D, within 50 m, in view",
        ]
        assert Detection().scores(make_run(Case(car, car)), OPTIONS)[0].matching == "bev 2 m, within 50 m"


class TestImage:
    def test_3d_results_are_scored_in_the_image_too(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (20, 5), label="car")
        run = make_run(Case(boxes3d((10, 0), (30, -5)), truth), rig=front_camera())
        assert counts(run, space="iou 0.5, truth projected from 3D") == (1, 1, 1, 0)

    def test_each_camera_is_scored_apart(self, make_run: MakeRun) -> None:
        box = (100, 100, 200, 200)
        truth = boxes2d(box, box, camera=["left", "right"], label="car")
        run = make_run(Case(boxes2d(box, camera="left"), truth2d=truth), rig=front_camera("left", "right"))
        assert counts(run, space="iou 0.5") == (1, 0, 1, 0)
        assert scores(run, space="iou 0.5")["f1"].counts["frames"] == 1

    def test_an_object_in_two_images_is_two_boxes(self, make_run: MakeRun) -> None:
        car = boxes3d((10, 0), label="car")
        assert counts(make_run(Case(car, car), rig=front_camera("a", "b")), space="iou") == (2, 0, 0, 0)

    def test_cameras_without_recorded_truth_arent_scored(self, make_run: MakeRun) -> None:
        box = (350, 250, 450, 350)
        run = make_run(
            Case(boxes2d(box, box, camera=["a", "b"]), truth2d=boxes2d(box, camera="a", label="car")),
            rig=front_camera("a", "b"),
        )
        assert counts(run, space="iou") == (1, 0, 0, 0)

    def test_a_pipeline_in_images_is_judged_in_the_cameras_that_it_got(self, tmp_path: Path) -> None:
        box = (100, 100, 200, 200)
        truth = boxes2d(box, box, camera=["a", "b"], label="car")
        frames = FrameEntry(reference="a", timeout_ns=1, tolerance_ns=1, max_gap_ns=1, sensors=["!b"])
        rig = front_camera("a", "b")
        run = write_run(tmp_path / "2d", [Case(boxes2d(box, camera="a"), truth2d=truth)], rig, frames=frames)
        assert counts(run, space="iou 0.5") == (1, 0, 0, 0)
        car = boxes3d((10, 0), label="car")
        run = write_run(tmp_path / "3d", [Case(car, car)], rig, frames=frames)
        assert counts(run, space="iou 0.5") == (2, 0, 0, 0)

    def test_lens_distortion_bends_what_is_projected(self, make_run: MakeRun) -> None:
        # The front face at x = 8 m: 400 * 0.125 * (1 - r2) with r2 = 0.125^2 + 0.09375^2 at its corners.
        straight = front_camera()
        camera = replace(straight.cameras["front"], distortion_model="plumb_bob", distortion=np.array([-1.0, 0, 0, 0]))
        rig = Rig(straight.mounts, {"front": camera})
        truth = boxes3d((10, 0), (10, 9), label="car")  # 400 * 0.9 is in view, but the lens folds at r = 0.577
        u, v = 50 * (1 - 0.125**2), 37.5 * (1 - 0.09375**2)
        box = (399.5 - u, 299.5 - v, 399.5 + u, 299.5 + v)
        run = make_run(Case(boxes2d(box), truth), rig=rig)
        assert counts(run, space="iou", options=ScoreOptions(iou=0.999)) == (1, 0, 0, 0)
        assert counts(make_run(Case(truth, truth), rig=rig), space="bev") == (1, 0, 0, 1)

    def test_lens_distortion_that_isnt_modeled_gives_no_scores_in_the_image(self, make_run: MakeRun) -> None:
        straight = front_camera()
        camera = replace(straight.cameras["front"], distortion_model="ds", distortion=np.array([0.1, 0.5]))
        car = boxes3d((10, 0), label="car")
        run = make_run(Case(car, car), rig=Rig(straight.mounts, {"front": camera}))
        assert scores(run, space="iou")["f1"].value is None
        assert scores(run, space="iou")["f1"].reason == "lens distortion of 'front' isn't modeled"
        assert counts(run, space="bev") == (1, 0, 0, 0)

    def test_a_camera_of_truth_without_intrinsics_gives_no_scores_in_the_image(self, make_run: MakeRun) -> None:
        """As where a camera was cut out of a log, and its truth wasn't."""
        car = boxes3d((10, 0), label="car")
        run = make_run(Case(car, car, boxes2d((380, 280, 420, 320), label="car")), rig=Rig({}, {}))
        assert scores(run, space="iou")["f1"].value is None
        assert scores(run, space="iou")["f1"].reason == "camera 'front' has no intrinsics"

    def test_recorded_2d_truth_is_preferred_and_said(self, make_run: MakeRun) -> None:
        box = (100, 100, 200, 200)
        case = Case(boxes2d(box), boxes3d((10, 0), label="car"), boxes2d(box, label="car"))
        run = make_run(case, rig=front_camera())
        rows = scores(run, space="iou")
        assert rows["f1"].matching == "iou 0.5"
        assert counts(run, space="iou") == (1, 0, 0, 0)

    def test_far_boxes_of_known_distance_are_outside(self, make_run: MakeRun) -> None:
        a, b, c = (0, 0, 9, 9), (100, 0, 109, 9), (200, 0, 209, 9)
        truth = boxes2d(a, b, label="car", distance=[20, 60])
        run = make_run(Case(boxes2d(a, b, c, distance=[51, np.nan, 70]), truth2d=truth), rig=front_camera())
        assert counts(run, space="iou 0.5, within 50 m") == (1, 0, 0, 2)

    def test_truth_cut_by_the_border_is_ignored_where_its_center_isnt_seen(self, make_run: MakeRun) -> None:
        edge = boxes3d((3, 3.2), label="car")
        run = make_run(Case(edge, edge), rig=front_camera())
        assert counts(run, space="iou") == (0, 0, 0, 1)
        assert counts(run, space="iou", options=ScoreOptions(in_view=False)) == (1, 0, 0, 0)

    def test_2d_estimates_are_scored_against_projected_truth(self, make_run: MakeRun) -> None:
        # Front face at x = 8 m: u = 399.5 +- 400 / 8, v = 299.5 +- 400 * 0.75 / 8.
        run = make_run(Case(boxes2d((349.5, 262, 449.5, 337)), boxes3d((10, 0), label="car")), rig=front_camera())
        assert counts(run, space="iou", options=ScoreOptions(iou=1.0)) == (1, 0, 0, 0)


class TestInvalid:
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
    def test_boxes_that_arent_finite_are_false_alarms_and_counted(self, make_run: MakeRun, bad: float) -> None:
        truth = boxes3d((10, 0), label="car")
        run = make_run(Case(boxes3d((10, 0), (bad, 0)), truth), rig=front_camera("a", "b"))
        for space, found in (("bev", 1), ("iou", 2)):
            assert counts(run, space=space) == (found, 1, 0, 0)
            assert scores(run, space=space)["f1"].counts["invalid"] == 1

    def test_scores_that_arent_finite_are_false_alarms(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), label="car")
        run = make_run(Case(boxes3d((10, 0), (20, 0), score=[np.nan, 0.5]), truth))
        assert counts(run) == (0, 2, 1, 0)

    def test_far_invalid_estimates_count_too(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes3d((80, 0), score=[np.inf]), NOTHING3D))
        assert counts(run) == (0, 1, 0, 0)

    def test_negative_sizes_are_invalid_in_space_and_in_images(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), label="car")
        inside_out = replace(boxes3d((10, 0)), size_lwh_m=np.array([[-4.0, 2.0, 1.5]]))
        run = make_run(Case(inside_out, truth), rig=front_camera("a", "b"))
        for space, missed in (("bev", 1), ("iou", 2)):
            assert counts(run, space=space) == (0, 1, missed, 0)
            assert scores(run, space=space)["f1"].counts["invalid"] == 1

    def test_2d_boxes_that_arent_finite(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes2d((0, 0, np.nan, 9)), truth2d=boxes2d((0, 0, 9, 9), label="car")), rig=front_camera())
        assert counts(run, space="iou") == (0, 1, 1, 0)

    def test_truth_that_isnt_finite_is_left_out_and_counted(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes3d((10, 0)), boxes3d((10, 0), (np.nan, 0), label="car")))
        assert counts(run) == (1, 0, 0, 0)
        assert scores(run)["f1"].counts["invalid_truth"] == 1


Places = list[tuple[float, float]]
PLACES = st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), max_size=6)
RUNS = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.slow
@RUNS
@given(PLACES, PLACES, st.randoms(use_true_random=False))
def test_the_order_of_boxes_changes_nothing(
    make_run: MakeRun, estimates: Places, truth: Places, random: Random
) -> None:
    def rows(a: Places, b: Places) -> Sequence[Score]:
        return Detection().scores(make_run(Case(boxes3d(*a), boxes3d(*b, label="car")), rig=front_camera()), OPTIONS)

    mixed_estimates, mixed_truth = random.sample(estimates, len(estimates)), random.sample(truth, len(truth))
    assert rows(estimates, truth) == rows(mixed_estimates, mixed_truth)


@pytest.mark.slow
@RUNS
@given(PLACES.filter(bool))
def test_estimates_that_equal_truth_score_one(make_run: MakeRun, places: Places) -> None:
    run = make_run(Case(boxes3d(*places), boxes3d(*places, label="car")), rig=front_camera())
    for space in ("bev", "iou"):
        found = values(run, space=space)
        assert {v for v in found.values() if v is not None} <= {1.0}
    assert values(run, options=ScoreOptions(range_m=100, in_view=False))["f1"] == 1.0


@RUNS
@given(PLACES, PLACES)
def test_every_box_is_counted_once(make_run: MakeRun, estimates: Places, truth: Places) -> None:
    run = make_run(Case(boxes3d(*estimates), boxes3d(*truth, label="car")))
    tp, fp, fn, ignored = counts(run, options=ScoreOptions(range_m=100))
    assert (tp + fp, tp + fn, ignored) == (len(estimates), len(truth), 0)
    tp, fp, fn, ignored = counts(run)
    assert tp + fp + ignored == len(estimates)
    assert tp + fn == sum(np.hypot(x, y) <= 50 for x, y in truth)
