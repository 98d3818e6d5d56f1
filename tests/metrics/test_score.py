"""All scores of a run: order, the same rows whatever was found, and bytes."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera, write_run

from fbench.metrics.comparison.counts import options_of
from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.protocols import Metric
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import Score, ScoreOptions, load_scores, save_scores, score_rows
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import rig_entry

METRICS: tuple[Metric, ...] = (Tracking(), Detection())
PRIMARY = ["f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw"]
OTHERS = [
    "idf1", "hota", "best_f1", "best_f1_threshold", "ap", "horizon_50", "horizon_80", "horizon_90", "deta",
    "assa", "loca", "idp", "idr", "frag", "mt", "pt", "ml", "occlusion_survival",
]  # fmt: skip
IN_IMAGES = ["distance_error", "range_rate_error"]


def all_scores(run: Run) -> list[Score]:
    return score_run(run, ScoreOptions(), METRICS)


def test_rows_of_a_3d_run_are_ordered(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), (20, 0), label=["car", "truck"], ids=[1, 2])
    rows = all_scores(make_run(Case(truth, truth), rig=front_camera()))
    whole = [r for r in rows if r.slice == "all"]
    every = [*PRIMARY, *OTHERS]
    assert [r.metric for r in whole] == [*every, *every, *IN_IMAGES, *every, *every, "coverage"]
    blocks = list(dict.fromkeys((r.class_, r.matching.split()[0]) for r in rows))
    assert blocks == [("vehicle", "bev"), ("vehicle", "iou"), ("car", "bev"), ("truck", "bev"), ("all", "bev")]
    assert [r.slice for r in rows if r.metric == "f1" and r.slice != "all"] == [
        "range 0-10 m", "range 10-20 m", "range 20-30 m", "range 30-50 m",
    ]  # fmt: skip


def test_a_2d_run_is_scored_in_the_image_alone(make_run: MakeRun) -> None:
    box = boxes2d((0, 0, 9, 9), label="car", ids=[1])
    rows = all_scores(make_run(Case(box, truth2d=box), rig=front_camera()))
    assert [r.metric for r in rows if r.class_ == "vehicle"] == [*PRIMARY, *OTHERS, *IN_IMAGES]
    assert {r.matching for r in rows} == {"iou 0.5"}
    assert rows[0].value == 1.0


def test_only_the_images_that_are_asked_for_are_scored(make_run: MakeRun) -> None:
    """A hit in one image, and a miss and a false alarm in the other; boxes in space are projected into one alone."""
    truth = boxes2d((0, 0, 9, 9), (0, 0, 9, 9), camera=["front", "rear"], label="car", ids=[1, 1])
    found = boxes2d((0, 0, 9, 9), (20, 0, 29, 9), camera=["front", "rear"], ids=[1, 2])
    run = make_run(Case(found, truth2d=truth), rig=front_camera("front", "rear"))
    front = score_run(run, ScoreOptions(cameras=("front",)), METRICS)[0]
    assert (front.value, front.matching) == (1.0, "iou 0.5, in image of front")
    assert [all_scores(run)[0].counts[name] for name in ("tp", "fp", "fn")] == [1, 1, 1]
    box, options = boxes3d((10, 0), label="car", ids=[1]), ScoreOptions(cameras=("rear",))
    rows = score_run(make_run(Case(box, box), rig=front_camera("front", "rear")), options, METRICS)
    assert next(row for row in rows if row.matching.startswith("iou")).counts["tp"] == 1
    assert options_of(rows) == options  # so that comparisons count the same


@pytest.mark.parametrize("truth", [None, Boxes3D.empty()])
def test_runs_without_truth_have_the_same_rows(make_run: MakeRun, truth: Boxes3D | None) -> None:
    found = boxes3d((10, 0), ids=[1])
    full = all_scores(make_run(Case(found, boxes3d((10, 0), label="car", ids=[1])), rig=front_camera()))
    empty = all_scores(make_run(Case(found, truth), rig=front_camera()))
    names = [[(r.metric, r.class_, r.matching) for r in rows if r.slice == "all"] for rows in (full, empty)]
    assert names[0] == names[1]
    assert [r.reason for r in empty[3:7]] == ["no truth" if truth is None else "no truth boxes"] * 4


def test_rows_of_other_metrics_follow(make_run: MakeRun) -> None:
    class Extra:
        def scores(self, run: Run, options: ScoreOptions) -> Sequence[Score]:
            matching = Detection().scores(run, options)[0].matching
            return [Score(m, "vehicle", "all", matching, 1.0, None, "1") for m in ("own", "other")]

    car = boxes3d((10, 0), label="car", ids=[1])
    rows = score_run(make_run(Case(car, car)), ScoreOptions(), (Extra(), *METRICS))
    own = [r.metric for r in rows if (r.class_, r.slice) == ("vehicle", "all") and r.matching.startswith("bev")]
    assert own == [*PRIMARY, *OTHERS, "own", "other"]


def test_equal_runs_give_equal_bytes_and_read_back(make_run: MakeRun, tmp_path: Path) -> None:
    truth = boxes3d((10, 0), (20, 0), (30, 3), label="car", ids=[1, 2, 3])
    cases = [Case(boxes3d((10.3, 0.1), (21, 0.7), ids=[1, 2]), truth)] * 3
    first, second = (all_scores(make_run(*cases, rig=front_camera())) for _ in range(2))
    save_scores(tmp_path / "a.json", first)
    save_scores(tmp_path / "b.json", second)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert load_scores(tmp_path / "a.json") == first


def test_scores_are_written_as_python_writes_json(tmp_path: Path) -> None:
    counts = {"tp": 3, "sum": 0.1}
    rows = [
        Score('a"\\\n', "car", "all", "iou 0.5", 1e-300, None, "1", counts, low=-0.0, high=1.0, interval="bootstrap"),
        Score("b", "Fußgänger", "all", "iou 0.5", None, "no truth", "m", counts),
        Score("b", "car", "", "\u2028", 3, None, "m", {}),
    ]
    for number, some in enumerate((rows, rows[1:], [])):
        save_scores(tmp_path / f"{number}.json", some)
        expected = json.dumps(score_rows(some), indent=1, allow_nan=False) + "\n"
        assert (tmp_path / f"{number}.json").read_text("utf-8") == expected


@pytest.mark.parametrize("options", [{"iou": 0.0}, {"iou": 1.1}, {"distance_m": 0.0}, {"range_m": float("nan")}])
def test_options_that_mean_nothing_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="score options"):
        ScoreOptions(**options)  # type: ignore[arg-type]


def test_a_changed_calibration_holds_from_its_segment_on(tmp_path: Path) -> None:
    """A box ahead is in view of a camera that looks ahead, and not of one that is turned by 180 degrees."""
    ahead = boxes3d((20, 0), label="car", ids=[1])
    rig = front_camera()
    x, y, z, w = rig.mounts["front"].rotation_xyzw
    turned = replace(rig.mounts["front"], rotation_xyzw=np.array([-y, x, w, -z]))
    change = rig_entry(1, Rig({**rig.mounts, "front": turned}, rig.cameras))
    cases = [Case(ahead, ahead), Case(ahead, ahead, segment=1)]
    same = write_run(tmp_path / "same", cases, rig)
    changed = write_run(tmp_path / "changed", cases, rig, rig_changes=[change])
    assert [all_scores(run)[0].counts["tp"] for run in (same, changed)] == [2, 1]
