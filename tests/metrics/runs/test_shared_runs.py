"""What metrics of one run share is what each would make for itself."""

from collections.abc import Sequence

from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera

from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.places import SharedRun, once
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

TRUTH = boxes3d((10, 0), (20, 3), (60, 0), label=["car", "bus", "car"], ids=[1, 2, 3])
FOUND = boxes3d((10.3, 0.1), (21, 2.7), ids=[1, 2], score=[0.5, 0.9])


def test_rows_are_those_of_each_metric_alone(make_run: MakeRun) -> None:
    for case in (Case(FOUND, TRUTH), Case(boxes2d((349.5, 262, 449.5, 337), ids=[1]), TRUTH)):
        run = make_run(case, case, rig=front_camera("a", "b"))
        alone = [row for metric in (Detection(), Tracking()) for row in metric.scores(run, ScoreOptions())]
        shared = score_run(run, ScoreOptions(), (Detection(), Tracking()))
        assert sorted(map(repr, alone)) == sorted(map(repr, shared))


def test_the_order_of_metrics_changes_no_value(make_run: MakeRun) -> None:
    run = make_run(Case(FOUND, TRUTH), rig=front_camera())
    forth, back = (score_run(run, ScoreOptions(), metrics) for metrics in
                   ((Detection(), Tracking()), (Tracking(), Detection())))  # fmt: skip
    assert sorted(map(repr, forth)) == sorted(map(repr, back))


def test_options_are_told_apart(make_run: MakeRun) -> None:
    class Twice:
        def scores(self, run: Run, options: ScoreOptions) -> Sequence[Score]:
            near = ScoreOptions(range_m=15)
            return [Detection().scores(run, options)[0], Detection().scores(run, near)[0]]

    run = make_run(Case(FOUND, TRUTH))
    assert [row.counts["tp"] for row in score_run(run, ScoreOptions(), (Twice(),))] == [2, 1]


def test_things_are_made_once_for_a_shared_run_only(make_run: MakeRun) -> None:
    run = make_run(Case(FOUND, TRUTH))
    made: list[int] = []

    def make() -> int:
        made.append(1)
        return len(made)

    assert [once(run, "x", make) for _ in range(2)] == [1, 2]
    shared = SharedRun(run.folder)
    assert [once(shared, key, make) for key in ("x", "x", "y")] == [3, 3, 4]
    assert once(SharedRun(run.folder), "x", make) == 5
