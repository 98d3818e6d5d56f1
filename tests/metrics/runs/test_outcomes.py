"""What became of every box of a run, by hand, and as the scores count it."""

from collections import Counter

import numpy as np
import pytest
from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera

from fbench.metrics.runs.detection import detection_entries
from fbench.metrics.runs.outcomes import outcomes_of
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.scores import ScoreOptions

OPTIONS = ScoreOptions()


def test_rows_are_those_of_the_tables(make_run: MakeRun) -> None:
    """The far detection comes first in the table; metrics sort by place."""
    found = boxes3d((23.4, 0), (10.5, 0), (60, 0), score=[0.8, 0.9, 0.9])
    truth = boxes3d((20, 0), (10, 0), (12, 30), label=["car", "car", "pedestrian"])
    outcomes = outcomes_of(make_run(Case(found, truth), Case(found)), OPTIONS)
    assert outcomes["detections"] == {(0, ""): "false alarm", (1, ""): "hit", (2, ""): "ignored"}  # frame 1: no truth
    assert outcomes["truth"] == {(0, ""): "missed", (1, ""): "hit", (2, ""): "ignored"}
    assert Counter(outcomes["tracks"].values()) == {"false alarm": 1, "hit": 1, "ignored": 1}


def test_labels_are_compared_one_by_one_where_the_pipeline_knows_them(make_run: MakeRun) -> None:
    found = boxes3d((10, 0), (20, 0), (30, 0), label=["pedestrian", "bicycle", "truck"])
    truth = boxes3d((10, 0), (20, 0), (30, 0), label=["pedestrian", "pedestrian", "car"])
    outcomes = outcomes_of(make_run(Case(found, truth)), OPTIONS)
    assert list(outcomes["detections"].values()) == ["hit", "false alarm", "hit"]
    assert sorted(outcomes["truth"].items()) == [((0, ""), "hit"), ((1, ""), "missed"), ((2, ""), "hit")]


def test_equal_and_invalid_boxes_have_a_place_each(make_run: MakeRun) -> None:
    found = boxes3d((10, 0), (10, 0), (np.nan, 0))
    outcomes = outcomes_of(make_run(Case(found, boxes3d((10, 0), label="car"))), OPTIONS)
    assert sorted(outcomes["detections"]) == [(0, ""), (1, ""), (2, "")]
    assert Counter(outcomes["detections"].values()) == {"hit": 1, "false alarm": 1, "invalid": 1}


def test_images(make_run: MakeRun) -> None:
    truth = boxes2d((0, 0, 10, 10), (0, 0, 10, 10), camera=["b", "a"], label="car")
    found = boxes2d((40, 40, 50, 50), (0, 0, 10, 8), camera=["a", "a"])
    outcomes = outcomes_of(make_run(Case(found, truth2d=truth), rig=front_camera("a", "b")), OPTIONS)
    assert outcomes["detections"] == {(0, "a"): "false alarm", (1, "a"): "hit"}
    assert outcomes["truth_2d"] == {(0, "b"): "missed", (1, "a"): "hit"}


def test_truth_projected_into_images(make_run: MakeRun) -> None:
    """A truth box comes once for each image that shows it."""
    run = make_run(Case(boxes2d((0, 0, 1, 1), camera="a"), boxes3d((10, 0), label="car")), rig=front_camera("a", "b"))
    assert outcomes_of(run, OPTIONS)["truth"] == {(0, "a"): "missed", (0, "b"): "missed"}


def test_runs_without_truth_have_no_outcomes(make_run: MakeRun) -> None:
    assert not any(outcomes_of(make_run(Case(boxes3d((10, 0)))), OPTIONS).values())


@pytest.mark.parametrize("seed", range(5))
def test_counts_are_those_of_the_scores(make_run: MakeRun, seed: int) -> None:
    rng = np.random.Generator(np.random.Philox(seed))

    def boxes(num: int) -> Boxes3D:
        labels = rng.choice(["car", "truck", "pedestrian"], num).tolist()
        return boxes3d(*rng.uniform(-20, 20, (num, 2)).tolist(), label=labels, score=rng.uniform(0, 1, num).tolist())

    run = make_run(*(Case(boxes(12), boxes(9)) for _ in range(4)))
    outcomes, entries = outcomes_of(run, OPTIONS), detection_entries(run, OPTIONS)
    native = {e.key.class_: e.counts.boxes for e in entries if e.key.slice == "all" and "bev" in e.key.matching}
    counts = [native["vehicle"], native["pedestrian"]]
    assert Counter(outcomes["truth"].values())["missed"] == sum(c.fn for c in counts)
    found = Counter(outcomes["detections"].values())
    assert (found["hit"], found["false alarm"]) == (sum(c.tp for c in counts), sum(c.fp for c in counts))
