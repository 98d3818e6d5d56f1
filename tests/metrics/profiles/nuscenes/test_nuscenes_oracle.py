"""The nuScenes profiles against nuscenes-devkit's own numbers."""

import json
from pathlib import Path
from typing import Any

import pytest
from tests.metrics.profiles.nuscenes.nuscenes_sequences import find, of_scene
from tests.metrics.profiles.nuscenes.oracles.nuscenes_scenes import DETECTION_PLANS, TRACKING_PLANS, scenes_of

from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.nuscenes.detection import NuscenesDetection
from fbench.metrics.profiles.nuscenes.ranking import ERRORS
from fbench.metrics.profiles.nuscenes.tracking import UNITS, NuscenesTracking
from fbench.replay.data.scores import Score

FROZEN = json.loads((Path(__file__).parent / "oracles" / "nuscenes_metrics.json").read_text())
DEVKIT_ERRORS = dict(zip(ERRORS, ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err"), strict=True))
COUNTS = ("gt", "tp", "fp", "fn", "ids", "frag", "mt", "ml")


def check(row: Score, devkit: float | None, exact: bool = False) -> None:
    """A row's value is the devkit's, or null with a reason that names what it prints."""
    what = f"{row.class_} {row.metric} {row.matching}"
    if row.value is None:
        printed = "nan" if devkit is None else f"{devkit:g}"
        assert str(row.reason).endswith(f"(nuscenes-devkit prints {printed})"), what
    elif exact:
        assert row.value == devkit, what
    else:
        assert row.value == pytest.approx(devkit, abs=1e-9, rel=0), what


@pytest.mark.parametrize("plan", DETECTION_PLANS)
def test_detection_is_the_devkits(plan: str) -> None:
    profile = NuscenesDetection()
    sequences = [of_scene(scene) for scene in scenes_of(DETECTION_PLANS[plan])]
    evaluation = evaluate(profile, sequences)
    rows, devkit = profile.scores(evaluation.total, "all"), FROZEN["detection"][plan]
    check(find(rows, "nds"), devkit["nd_score"])
    check(find(rows, "map"), devkit["mean_ap"])
    for name in profile.settings.rules.classes:
        check(find(rows, "mean_dist_ap", name), devkit["mean_dist_aps"][name])
        for distance, ap in devkit["label_aps"][name].items():
            check(find(rows, "ap", name, f"bev {float(distance):g} m"), ap)
    for ours, theirs in DEVKIT_ERRORS.items():
        check(find(rows, f"m{ours}"), devkit["tp_errors"][theirs])
        for name in profile.settings.rules.classes:
            check(find(rows, ours, name), devkit["label_tp_errors"][name][theirs])


@pytest.mark.parametrize("plan", TRACKING_PLANS)
def test_tracking_is_the_devkits(plan: str) -> None:
    profile = NuscenesTracking()
    sequences = [of_scene(scene) for scene in scenes_of(TRACKING_PLANS[plan])]
    rows = profile.scores(evaluate(profile, sequences).total, "all")
    devkit: dict[str, Any] = FROZEN["tracking"][plan]
    for metric in UNITS:
        check(find(rows, metric), devkit["all"][metric])
        for name in profile.settings.rules.classes:
            check(find(rows, metric, name), devkit["classes"][metric][name], exact=metric in COUNTS)
