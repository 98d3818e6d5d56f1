"""Freeze what nuscenes-devkit makes of the random scenes, as `nuscenes_metrics.json`.

Made with nuscenes-devkit 1.2.0 (motmetrics 1.4.0, which its tracking evaluation needs on Python 3.10 and later: its
`setup/requirements/requirements_tracking.txt` pins it, and its own accumulator is written for it; numpy 1.26.4, pandas
1.5.3, scikit-learn 1.9.1). Run it from the root of the repository, in an environment of
its own, since the devkit needs numpy below 2:

    python -m venv /tmp/devkit && /tmp/devkit/bin/pip install nuscenes-devkit==1.2.0 motmetrics==1.4.0
    PYTHONPATH=. /tmp/devkit/bin/python -m tests.metrics.profiles.nuscenes.oracles.make_nuscenes_metrics

No dataset is needed: the devkit's filters, tracks and evaluations get the boxes directly. Where several choices are
equal the devkit goes by the order of boxes and fbench by their place, so the boxes are put in the order of their place
before tracking; results of detection in the reverse order, because of equal scores the devkit takes the last first.
`--as-given` leaves them as they come and tells how much that changes.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from nuscenes.eval.common.config import config_factory  # type: ignore[import-not-found]
from nuscenes.eval.common.data_classes import EvalBoxes  # type: ignore[import-not-found]
from nuscenes.eval.common.loaders import add_center_dist, filter_eval_boxes  # type: ignore[import-not-found]
from nuscenes.eval.detection.data_classes import DetectionBox  # type: ignore[import-not-found]
from nuscenes.eval.detection.evaluate import DetectionEval  # type: ignore[import-not-found]
from nuscenes.eval.tracking import loaders  # type: ignore[import-not-found]
from nuscenes.eval.tracking.data_classes import TrackingBox  # type: ignore[import-not-found]
from nuscenes.eval.tracking.evaluate import TrackingEval  # type: ignore[import-not-found]
from tests.metrics.profiles.nuscenes.oracles.nuscenes_scenes import (
    DETECTION_PLANS,
    RACK,
    TRACKING_PLANS,
    Plan,
    Row,
    Scene,
    scenes_of,
)


class Tables:
    """What the devkit asks a dataset for."""

    def __init__(self, scenes: list[Scene]) -> None:
        self.rows: dict[tuple[str, str], dict[str, Any]] = {}
        for scene in scenes:
            tokens = [token(scene, step) for step in range(len(scene.stamp_us))]
            ends = {"first_sample_token": tokens[0], "last_sample_token": tokens[-1]}
            self.rows["scene", scene.name] = {"name": scene.name, **ends}
            for step, own in enumerate(tokens):
                racks = [r for r in scene.truth if r["name"] == RACK and r["step"] == step]
                names = [f"{own}-rack{i}" for i in range(len(racks))]
                self.rows["sample", own] = {
                    "scene_token": scene.name, "timestamp": scene.stamp_us[step], "anns": names,
                    "data": {"LIDAR_TOP": own}, "next": (*tokens, "")[step + 1],
                }  # fmt: skip
                self.rows["sample_data", own] = {"ego_pose_token": own}
                self.rows["ego_pose", own] = {"translation": scene.ego[step]}
                for name, rack in zip(names, racks, strict=True):
                    self.rows["sample_annotation", name] = {"category_name": RACK, **placed(rack)}

    def get(self, table: str, own: str) -> dict[str, Any]:
        return self.rows[table, own]


def token(scene: Scene, step: int) -> str:
    return f"{scene.name}-{step:03d}"


def placed(row: Row) -> dict[str, Any]:
    length, width, height = row["lwh"]
    half = row["yaw"] / 2
    rotation = (math.cos(half), 0.0, 0.0, math.sin(half))
    return {"translation": row["xyz"], "size": (width, length, height), "rotation": rotation}


def detection_box(scene: Scene, row: Row) -> DetectionBox:
    return DetectionBox(
        token(scene, row["step"]), velocity=row["velocity"], num_pts=row["points"], detection_name=row["name"],
        detection_score=row["score"], attribute_name=row["attribute"], **placed(row),
    )  # fmt: skip


def tracking_box(scene: Scene, row: Row) -> TrackingBox:
    return TrackingBox(
        token(scene, row["step"]), velocity=row["velocity"], num_pts=row["points"], tracking_name=row["name"],
        tracking_score=row["score"], tracking_id=f"{scene.name}-{row['id']}", **placed(row),
    )  # fmt: skip


def boxes(scenes: list[Scene], side: str, make: Any) -> EvalBoxes:
    result = EvalBoxes()
    for scene in scenes:
        for step in range(len(scene.stamp_us)):
            rows = [r for r in getattr(scene, side) if r["step"] == step and r["name"] != RACK]
            result.add_boxes(token(scene, step), [make(scene, row) for row in rows])
    return result


def both_sides(scenes: list[Scene], tables: Tables, config: Any, make: Any) -> tuple[EvalBoxes, EvalBoxes]:
    sides = [add_center_dist(tables, boxes(scenes, side, make)) for side in ("truth", "results")]
    truth, results = (filter_eval_boxes(tables, side, config.class_range) for side in sides)
    return truth, results


def reverse(results: EvalBoxes) -> EvalBoxes:
    reversed_ = EvalBoxes()
    for sample in sorted(results.sample_tokens, reverse=True):
        reversed_.add_boxes(sample, sorted(results[sample], key=lambda box: tuple(box.translation), reverse=True))
    return reversed_


def detection(plan: Plan, by_place: bool) -> dict[str, Any]:
    scenes = scenes_of(plan)
    evaluation = DetectionEval.__new__(DetectionEval)
    evaluation.cfg, evaluation.verbose = config_factory("detection_cvpr_2019"), False
    sides = both_sides(scenes, Tables(scenes), evaluation.cfg, detection_box)
    evaluation.gt_boxes, evaluation.pred_boxes = sides[0], reverse(sides[1]) if by_place else sides[1]
    metrics = evaluation.evaluate()[0].serialize()
    wanted = ("nd_score", "mean_ap", "tp_errors", "label_aps", "mean_dist_aps", "label_tp_errors")
    return {name: metrics[name] for name in wanted}


def tracking(plan: Plan, by_place: bool) -> dict[str, Any]:
    scenes = scenes_of(plan)
    tables = Tables(scenes)
    loaders.get_scenes_of_split = lambda split_name, nusc: [scene.name for scene in scenes]
    evaluation = TrackingEval.__new__(TrackingEval)
    evaluation.cfg, evaluation.verbose = config_factory("tracking_nips_2019"), False
    evaluation.output_dir, evaluation.render_classes = "", []
    truth, results = both_sides(scenes, tables, evaluation.cfg, tracking_box)
    evaluation.tracks_gt = loaders.create_tracks(truth, tables, "", gt=True)
    evaluation.tracks_pred = loaders.create_tracks(results, tables, "", gt=False)
    if by_place:
        for tracks in (evaluation.tracks_gt, evaluation.tracks_pred):
            for frames in tracks.values():
                for frame in frames.values():
                    frame.sort(key=lambda box: tuple(box.translation))
    metrics = evaluation.evaluate()[0]
    overall = {name: metrics.compute_metric(name) for name in metrics.metric_names}
    return {"all": overall, "classes": metrics.label_metrics}


def without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): without_nan(v) for k, v in value.items()}
    return None if np.isnan(value) else float(value)


def say(name: str, what: object) -> None:
    sys.stdout.write(f"{name} {what}\n")


def compare() -> None:
    for name, plan in DETECTION_PLANS.items():
        say(name, [detection(plan, by_place)["nd_score"] for by_place in (True, False)])
    for name, plan in TRACKING_PLANS.items():
        sorted_, given = (without_nan(tracking(plan, by_place)["all"]) for by_place in (True, False))
        say(name, [(metric, value, given[metric]) for metric, value in sorted_.items() if value != given[metric]])


def main() -> None:
    if "--as-given" in sys.argv:
        compare()
        return
    numbers = {
        "detection": {name: without_nan(detection(plan, True)) for name, plan in DETECTION_PLANS.items()},
        "tracking": {name: without_nan(tracking(plan, True)) for name, plan in TRACKING_PLANS.items()},
    }
    path = Path(__file__).with_name("nuscenes_metrics.json")
    path.write_text(json.dumps(numbers, indent=0) + "\n")


if __name__ == "__main__":
    main()
