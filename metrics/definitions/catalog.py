"""Definitions of every metric that a row can have; those of detection stand here."""

from collections.abc import Mapping

from fbench.metrics.definitions import tracking
from fbench.metrics.definitions.definition import (
    CAESAR,
    FBENCH,
    GEIGER,
    LIN,
    RIJSBERGEN,
    SHARE,
    SIMONELLI,
    MetricDefinition,
)
from fbench.replay.contracts.errors import ConfigError, did_you_mean

_NO_TRUTH = "there are no truth boxes"

OPERATING_POINT = (
    MetricDefinition(
        "f1", "How well boxes are found at the score threshold that the results have.", "2 TP / (2 TP + FP + FN)",
        SHARE, "higher", "there are neither truth nor results", RIJSBERGEN,
        by_profile={"kitti-3dmot": "2 P R / (P + R) at the score with the best MOTA."},
    ),
    MetricDefinition(
        "precision", "Share of results that are right.", "TP / (TP + FP)", SHARE, "higher", "there are no results",
        RIJSBERGEN, by_profile={"kitti-3dmot": "At the score with the best MOTA."},
    ),
    MetricDefinition(
        "recall", "Share of truth that is found.", "TP / (TP + FN)", SHARE, "higher", _NO_TRUTH, RIJSBERGEN,
        by_profile={
            "kitti-3dmot": "At the score with the best MOTA; hits on ignored truth count.",
            "nuscenes-tracking": "At the score with the best MOTA.",
        },
    ),
    MetricDefinition(
        "coverage", "Share of the run's frames that have truth and so were scored.", "scored frames / frames", SHARE,
        "higher", "there are no frames", FBENCH,
    ),
    MetricDefinition(
        "best_f1", "F1 at the score threshold that is best for it.", "max over thresholds of F1", SHARE, "higher",
        "there is no truth, or results have no scores", RIJSBERGEN,
    ),
    MetricDefinition(
        "best_f1_threshold", "The score from which on results give the best F1.", "argmax over thresholds of F1",
        "any score", "neither", "there is no truth, or results have no scores", RIJSBERGEN,
    ),
    MetricDefinition(
        "distance_error", "Mean absolute error of the distance that 2D results tell.",
        "mean over hits of |d - d_truth|", "from 0 up", "lower", "no hit tells its distance", FBENCH, "m",
    ),
    MetricDefinition(
        "range_rate_error", "Mean absolute error of the range rate that 2D results tell.",
        "mean over hits of |v - v_truth|", "from 0 up", "lower", "no hit tells its range rate", FBENCH, "m/s",
    ),
)  # fmt: skip

AVERAGE_PRECISION = (
    MetricDefinition(
        "ap", "Precision, averaged over recalls: how well scores rank right results before wrong ones.",
        "mean over recalls r of max precision at recall >= r", SHARE, "higher",
        "there is no truth, or results have no scores", LIN,
        by_profile={
            "coco": "101 recalls, mean over 10 overlaps from 0.5 to 0.95.",
            "kitti-object": f"40 recalls from 1/40 to 1 ({SIMONELLI.authors} {SIMONELLI.year}), a row for each "
            "difficulty and overlap.",
            "nuscenes-detection": "101 recalls; those up to 0.1 are left out, precision counts from 0.1: "
            "mean(max(p - 0.1, 0)) / 0.9, a row for each distance.",
        },
    ),
    MetricDefinition(
        "ap11", "AP as KITTI had it until 2019.", "mean over the recalls 0, 0.1 ... 1 of max precision", SHARE,
        "higher", _NO_TRUTH, GEIGER,
    ),
    MetricDefinition(
        "ap40", "AP over 40 recalls; in the profile kitti-object it is called ap.", "mean over 1/40 ... 1 of precision",
        SHARE, "higher", _NO_TRUTH, SIMONELLI,
    ),
    MetricDefinition(
        "aos", "AP in which each hit counts as much as its observation angle is right.",
        "mean over 40 recalls of max sum((1 + cos(alpha - alpha_truth)) / 2) / (TP + FP)", "0 to ap", "higher",
        "there is no truth, or nobody tells observation angles", GEIGER,
    ),
    MetricDefinition(
        "aos11", "AOS as KITTI had it until 2019.", "as aos, over the recalls 0, 0.1 ... 1", "0 to ap11", "higher",
        "there is no truth, or nobody tells observation angles", GEIGER,
    ),
)  # fmt: skip


def _coco(name: str, meaning: str, formula: str) -> MetricDefinition:
    return MetricDefinition(name, meaning, formula, SHARE, "higher", f"{_NO_TRUTH} of that size", LIN)


COCO = (
    _coco("ap50", "AP at an overlap of 0.5.", "AP at IoU 0.5"),
    _coco("ap75", "AP at an overlap of 0.75.", "AP at IoU 0.75"),
    _coco("aps", "AP of small boxes.", "AP of areas up to 32 x 32 px"),
    _coco("apm", "AP of medium boxes.", "AP of areas from 32 x 32 to 96 x 96 px"),
    _coco("apl", "AP of large boxes.", "AP of areas from 96 x 96 px on"),
    _coco("ar1", "Recall with the best result of each class and image.", "mean over 10 overlaps of recall"),
    _coco("ar10", "Recall with up to 10 results of a class in an image.", "mean over 10 overlaps of recall"),
    _coco("ar100", "Recall with up to 100 results of a class in an image.", "mean over 10 overlaps of recall"),
    _coco("ars", "Recall of small boxes.", "AR100 of areas up to 32 x 32 px"),
    _coco("arm", "Recall of medium boxes.", "AR100 of areas from 32 x 32 to 96 x 96 px"),
    _coco("arl", "Recall of large boxes.", "AR100 of areas from 96 x 96 px on"),
)


def _error(name: str, of: str, formula: str, unit: str, not_for: str = "") -> tuple[MetricDefinition, MetricDefinition]:
    """Cards of an error of one class, and of its mean over classes."""
    undefined = f"{_NO_TRUTH} of the class" + (f", and for {not_for}" if not_for else "")
    how = "mean of the running mean over recalls from 0.1 to the highest; 1 where 0.1 isn't reached"
    one = MetricDefinition(
        name, f"{of} of hits within 2 m.", f"{formula}; {how}", "from 0 up", "lower", undefined, CAESAR, unit
    )  # fmt: skip
    mean = MetricDefinition(
        f"m{name}", f"{of} of hits within 2 m, over classes.", f"mean over classes of {name}", "from 0 up", "lower",
        "no class has one", CAESAR, unit,
    )  # fmt: skip
    return one, mean


NUSCENES = (
    MetricDefinition(
        "nds", "nuScenes detection score: average precision and five errors in one number.",
        "(5 mAP + sum over errors of max(1 - error, 0)) / 10", SHARE, "higher", "there is no truth", CAESAR,
    ),
    MetricDefinition(
        "map", "Average precision over classes and distances.", "mean over classes of mean_dist_ap", SHARE, "higher",
        "there is no truth", CAESAR,
    ),
    MetricDefinition(
        "mean_dist_ap", "Average precision of a class over distances.", "mean over 0.5, 1, 2, 4 m of ap", SHARE,
        "higher", f"{_NO_TRUTH} of the class", CAESAR,
    ),
    *_error("ate", "Error of position", "distance of centres in the ground plane", "m"),
    *_error("ase", "Error of size", "1 - IoU of the boxes with centre and heading alike", "1"),
    *_error("aoe", "Error of heading", "smallest difference of yaw, of barriers up to half a turn", "rad", "cones"),
    *_error("ave", "Error of velocity", "length of the difference in the ground plane", "m/s", "barriers and cones"),
    *_error("aae", "Error of attributes", "1 - share of right attributes", "1", "barriers and cones"),
)  # fmt: skip

DETECTION_DEFINITIONS = (*OPERATING_POINT, *AVERAGE_PRECISION, *COCO, *NUSCENES)


DEFINITIONS: Mapping[str, MetricDefinition] = {
    definition.name: definition
    for definition in (*DETECTION_DEFINITIONS, *tracking.TRACKING_DEFINITIONS, *tracking.BENCHMARK_DEFINITIONS)
}
COUNTS = frozenset(definition.name for definition in DEFINITIONS.values() if definition.is_count)


def definition_of(name: str) -> MetricDefinition:
    """Return the definition of a metric. Raises ConfigError for an unknown name, with the nearest one."""
    if name not in DEFINITIONS:
        raise ConfigError(f"unknown metric '{name}'{did_you_mean(name, DEFINITIONS)}")
    return DEFINITIONS[name]
