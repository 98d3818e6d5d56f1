"""Scores: one row a number, as written to `scores.json`."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from fbench.replay.errors import ConfigError, MetricError, RunError
from fbench.replay.files import replace_text


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

    def __post_init__(self) -> None:
        if not (self.range_m > 0 and 0 < self.distance_m < math.inf):
            raise ConfigError(f"score options: range {self.range_m} m, distance {self.distance_m} m: expected above 0")
        if not 0 < self.iou <= 1:
            raise ConfigError(f"score options: iou {self.iou}: expected above 0 and up to 1")


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

    def __post_init__(self) -> None:
        if self.value is not None and not math.isfinite(self.value):
            raise MetricError(
                f"score {self.metric} ({self.matching}): {self.value} isn't a number, use null and a reason"
            )
        if (self.value is None) != (self.reason is not None):
            raise MetricError(f"score {self.metric} ({self.matching}): a reason goes with null and only with null")


def ratio(
    metric: str,
    class_: str,
    matching: str,
    top: float,
    bottom: float,
    why: str,
    counts: Mapping[str, int | float],
    unit: str = "1",
) -> Score:
    """Return `top / bottom` as a score over all frames, or null with the reason `why` when `bottom` is 0."""
    value = top / bottom if bottom else None
    return Score(metric, class_, "all", matching, value, None if bottom else why, unit, counts)


def save_scores(path: Path, scores: Sequence[Score]) -> None:
    """Write scores as JSON; equal scores give equal bytes."""
    rows = [{("class" if k == "class_" else k): v for k, v in asdict(score).items()} for score in scores]
    replace_text(path, json.dumps(rows, indent=1, allow_nan=False) + "\n")


def load_scores(path: Path) -> list[Score]:
    """Read what `save_scores` wrote.

    Raises:
        RunError: where the file is missing or isn't a list of scores.
    """
    try:
        rows = json.loads(path.read_text())
        return [Score(**{("class_" if k == "class" else k): v for k, v in row.items()}) for row in rows]
    except FileNotFoundError:
        raise RunError(f"{path}: no scores, run `fbench score {path.parent}`") from None
    except (ValueError, TypeError, AttributeError) as error:
        raise RunError(f"{path}: not a list of scores ({error})") from error
