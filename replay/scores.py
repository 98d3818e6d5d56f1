"""Scores: one row a number, as written to `scores.json`."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from fbench.replay.errors import ConfigError, MetricError, RunError
from fbench.replay.files import replace_text

_OF_INTERVALS = ("low", "high", "interval")


@dataclass(frozen=True)
class ScoreOptions:
    """What is scored and how boxes are matched."""

    range_m: float = 50.0
    """Region of interest: distance in the ground plane from the body's origin."""
    in_view: bool = True
    """Region of interest: only objects whose centre a camera of the rig sees, where the rig has cameras."""
    distance_m: float = 2.0
    """3D boxes match when their centres are this near in the ground plane."""
    iou: float = 0.5
    """2D boxes match from this intersection over union on."""
    regions: tuple[str, ...] = ()
    """Region of interest: only objects in the log's regions of these kinds, such as `road`; all where empty."""
    seen: int = 0
    """Region of interest: only objects that some sensor of the log sees, as its truth tells: with so many points of a
    LiDAR or radar, or in an image; 0: all.
    """

    def __post_init__(self) -> None:
        if not (self.range_m > 0 and 0 < self.distance_m < math.inf):
            raise ConfigError(f"score options: range {self.range_m} m, distance {self.distance_m} m: expected above 0")
        if not 0 < self.iou <= 1:
            raise ConfigError(f"score options: iou {self.iou}: expected above 0 and up to 1")
        if self.seen < 0:
            raise ConfigError(f"score options: seen with {self.seen} points: expected 0 or more")
        if "" in self.regions:
            raise ConfigError("score options: a kind of region has no name; write them as road,sidewalk")


def region_kinds(text: str | None) -> tuple[str, ...]:
    """Read what follows `--region`: kinds of regions with commas between."""
    return () if text is None else tuple(dict.fromkeys(name.strip() for name in text.split(",")))


@dataclass(frozen=True)
class Score:
    """One number with everything that says what it is; `value` is `None` with a `reason` where undefined."""

    metric: str
    """f1, precision, recall, mota ..."""
    class_: str
    """`vehicle`: all vehicles as one class; else a label."""
    slice: str
    """`all`, or what part of the frames or boxes it is about."""
    matching: str
    """`bev 2 m`, `iou 0.5` ..."""
    value: float | None
    reason: str | None
    unit: str
    """`1` for ratios and counts."""
    counts: Mapping[str, int | float] = field(default_factory=dict)
    """Raw counts, which can be added over runs."""
    low: float | None = None
    """Lower end of the confidence interval; `None` where there is none."""
    high: float | None = None
    interval: str | None = None
    """How the interval was made: `95 % of 1000 bootstrap resamples of 21 logs`; or why there is none."""

    def __post_init__(self) -> None:
        if self.value is not None and not math.isfinite(self.value):
            raise MetricError(
                f"score {self.metric} ({self.matching}): {self.value} isn't a number, use null and a reason"
            )
        if (self.value is None) != (self.reason is not None):
            raise MetricError(f"score {self.metric} ({self.matching}): a reason goes with null and only with null")
        ends = [end for end in (self.low, self.high) if end is not None]
        if len(ends) == 1 or not all(map(math.isfinite, ends)) or ends != sorted(ends) or (ends and not self.interval):
            raise MetricError(f"score {self.metric} ({self.matching}): {self.low} to {self.high} isn't an interval")


def ratio(
    metric: str,
    class_: str,
    matching: str,
    top: float,
    bottom: float,
    why: str,
    counts: Mapping[str, int | float],
    unit: str = "1",
    part: str = "all",
) -> Score:
    """Return `top / bottom` as a score of a slice, or null with the reason `why` when `bottom` is 0."""
    value = top / bottom if bottom else None
    return Score(metric, class_, part, matching, value, None if bottom else why, unit, counts)


def save_scores(path: Path, scores: Sequence[Score]) -> None:
    """Write scores as JSON; equal scores give equal bytes."""
    replace_text(path, json.dumps(score_rows(scores), indent=1, allow_nan=False) + "\n")


def score_rows(scores: Sequence[Score]) -> list[dict[str, object]]:
    """Return scores as they stand in `scores.json`; nothing is said of intervals where none was asked for."""
    return [_row(score) for score in scores]


def _row(score: Score) -> dict[str, object]:
    values = {("class" if f.name == "class_" else f.name): getattr(score, f.name) for f in fields(score)}
    unsaid = {name for name in _OF_INTERVALS if values[name] is None}
    return {name: value for name, value in values.items() if name not in unsaid} | {"counts": dict(score.counts)}


def load_scores(path: Path) -> list[Score]:
    """Read what `save_scores` wrote.

    Raises:
        RunError: where the file is missing or isn't a list of scores.
    """
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return [Score(**{("class_" if k == "class" else k): v for k, v in row.items()}) for row in rows]
    except FileNotFoundError:
        raise RunError(f"{path}: no scores, run `fbench score {path.parent}`") from None
    except (ValueError, TypeError, AttributeError) as error:
        raise RunError(f"{path}: not a list of scores ({error})") from error
