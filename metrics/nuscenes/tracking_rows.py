"""AMOTA, AMOTP and what CLEAR counts, as rows."""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from fbench.metrics.nuscenes.clear_values import UNITS, ClassValues, class_values
from fbench.metrics.nuscenes.clip import TrackingStatistics
from fbench.metrics.nuscenes.settings import TrackingSettings
from fbench.replay.scores import Score

SUMMED = ("mt", "ml", "tp", "fp", "fn", "ids", "frag")
"""Over classes; all others are averaged, `gt` too (nuscenes-devkit 1.2.0, eval/tracking/data_classes.py)."""


def tracking_rows(settings: TrackingSettings, statistics: TrackingStatistics, part: str) -> list[Score]:
    """Return all metrics over the classes, then of each class."""
    names = settings.rules.classes
    classes = {
        name: class_values([clip for clip in statistics.clips if clip.kind == kind], settings)
        for kind, name in enumerate(names)
    }
    rows = _overall_rows(settings, classes, asdict(statistics.left_out), part)
    for name, one in classes.items():
        for metric in UNITS:
            value = one.values[metric]
            rows.append(_row(settings, metric, name, part, value, _why(one), _counts(one)))
    return rows


def _overall_rows(
    settings: TrackingSettings, classes: Mapping[str, ClassValues], left_out: Mapping[str, int], part: str
) -> list[Score]:
    found = [one for one in classes.values() if one.num_truth]
    sums = {name: int(sum(_known([one.values[name] for one in found]))) for name in ("tp", "fp", "fn", "ids")}
    counts = {"gt": sum(one.num_truth for one in found), **sums, **left_out}
    counts["classes_without_truth"] = len(classes) - len(found)
    rows = []
    for metric in UNITS:
        known = _known([one.values[metric] for one in found])
        total = (float(np.sum(known)) if metric in SUMMED else float(np.mean(known))) if known else np.nan
        why = "nothing matched in any class" if found else "no truth boxes"
        rows.append(_row(settings, metric, "all", part, total, _prints(why, metric in SUMMED), counts))
    return rows


def _row(
    settings: TrackingSettings, metric: str, name: str, part: str, value: float, why: str,
    counts: Mapping[str, int | float],
) -> Score:  # fmt: skip
    known = not np.isnan(value)
    return Score(
        metric,
        name,
        part,
        settings.matching,
        float(value) if known else None,
        None if known else why,
        UNITS[metric],
        counts,
    )


def _known(values: list[float]) -> list[float]:
    return [value for value in values if not np.isnan(value)]


def _why(one: ClassValues) -> str:
    return _prints("nothing matched" if one.num_truth else "no truth boxes", False)


def _prints(why: str, summed: bool) -> str:
    return f"{why} (nuscenes-devkit prints {0 if summed else 'nan'})"


def _counts(one: ClassValues) -> dict[str, int | float]:
    counts: dict[str, int | float] = {"gt": one.num_truth, "frames": one.frames, "recalls_reached": one.num_reached}
    for name in ("tp", "fp", "fn", "ids"):
        if not np.isnan(one.values[name]):
            counts[name] = int(one.values[name])
    return counts if one.threshold is None else counts | {"score": one.threshold}
