"""The tracking metrics of one class as nuscenes-devkit counts them, NaN where it prints that."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.metrics.nuscenes.clip import Clip
from fbench.metrics.nuscenes.recalls import Sweep, sweep_class
from fbench.metrics.nuscenes.settings import TrackingSettings
from fbench.replay.arrays import Float64

UNITS = {
    "amota": "1", "amotp": "m", "recall": "1", "motar": "1", "gt": "1", "mota": "1", "motp": "m", "mt": "1", "ml": "1",
    "faf": "1", "tp": "1", "fp": "1", "fn": "1", "ids": "1", "frag": "1", "tid": "s", "lgd": "s",
}  # fmt: skip
"""The metrics and their units; `faf` is false positives per 100 samples."""


@dataclass(frozen=True)
class ClassValues:
    """One class over all sequences."""

    num_truth: int
    """Truth boxes, those filled in included."""
    num_reached: int
    """Thresholds whose recall is reached."""
    threshold: float | None
    """Score from which on results are taken for all but AMOTA and AMOTP: the one of the best MOTA."""
    frames: int
    """Samples with any box of the class at that score."""
    values: Mapping[str, float]
    """All of `UNITS`."""


def class_values(clips: Sequence[Clip], settings: TrackingSettings) -> ClassValues:
    """Return the metrics of one class from its clips."""
    num_truth = sum(len(clip.truth_track) for clip in clips)
    if not num_truth:
        return ClassValues(0, 0, None, 0, dict.fromkeys(UNITS, np.nan))
    swept = sweep_class(clips, settings)
    if not len(swept.threshold):
        return ClassValues(num_truth, 0, None, 0, _nothing(clips, num_truth, settings))
    metrics = _curves(swept, num_truth, settings)
    best = int(np.argmax(metrics["mota"]))  # the highest recall among equals
    values = {name: float(curve[best]) for name, curve in metrics.items()}
    values["amota"] = _mean(metrics["motar"], settings.worst_amota, settings)
    values["amotp"] = _mean(metrics["motp"], settings.worst_amotp_m, settings)
    frames = swept.num("frames")
    return ClassValues(num_truth, len(swept.threshold), float(swept.threshold[best]), int(frames[best]), values)


def _curves(swept: Sweep, num_truth: int, settings: TrackingSettings) -> dict[str, Float64]:
    """Each metric (T,) at the thresholds that are reached; nuscenes-devkit 1.2.0, eval/tracking/metrics.py."""
    counts = {name: swept.num(name) for name in ("tp", "ids", "fp", "fn", "mt", "ml", "frag")}
    tp, ids, fp, fn, found = (*(counts[name] for name in ("tp", "ids", "fp", "fn")), swept.num("found"))
    recall = tp / num_truth  # for MOTAR, without switches
    wrong = fn + ids + fp
    motar = 1 - _share(wrong - (1 - recall) * num_truth, recall * num_truth)
    return counts | {
        "recall": (tp + ids) / num_truth,
        "motar": np.maximum(0.0, motar),  # keeps NaN
        "gt": np.full(len(tp), num_truth, np.float64),
        "mota": np.maximum(0.0, 1 - wrong / num_truth),
        "motp": _share(swept.total_m, tp + ids),
        "faf": 100 * _share(fp, swept.num("frames")),
        "tid": settings.sample_s * _share(swept.num("late"), found),
        "lgd": settings.sample_s * _share(swept.num("gap"), found),
    }


def _nothing(clips: Sequence[Clip], num_truth: int, settings: TrackingSettings) -> dict[str, float]:
    """What the devkit puts where no result ever matches."""
    values = dict.fromkeys(UNITS, 0.0)
    values |= dict.fromkeys(("fp", "ids", "frag"), np.nan) | {"gt": num_truth, "fn": num_truth}
    values |= {"motp": settings.worst_amotp_m, "amotp": settings.worst_amotp_m, "faf": settings.worst_faf}
    values |= {"tid": settings.worst_duration_s, "lgd": settings.worst_duration_s}
    return values | {"ml": sum(clip.num_truth_tracks for clip in clips)}


def _share(part: Float64, whole: Float64) -> Float64:
    share: Float64 = np.divide(part, whole, out=np.full(len(part), np.nan), where=whole != 0)
    return share


def _mean(curve: Float64, worst: float, settings: TrackingSettings) -> float:
    """Mean over all thresholds, with the worst value where one isn't reached or the metric is undefined."""
    if np.isnan(curve).all():
        return float("nan")
    missing = settings.num_thresholds - len(curve)
    return float(np.mean(np.append(np.full(missing, worst), np.where(np.isnan(curve), worst, curve))))
