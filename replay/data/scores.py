"""Scores, one row a number as written to `scores.json`, and tables of them ready to be shown."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, TypeAlias

from fbench.replay.contracts.errors import ConfigError, MetricError, RunError
from fbench.replay.data.files import replace_text

LOCKSTEP, STREAMING, FORECAST = "lockstep", "streaming", "streaming, forecast"
"""Slices of a run with latency: each frame with its own output, however late; with the latest output that was ready at
its instant; and with that moved on to the instant."""
_OF_INTERVALS = ("low", "high", "interval")


@dataclass(frozen=True)
class ScoreOptions:
    """What is scored and how boxes are matched."""

    range_m: float = 50.0
    """Region of interest: distance in the ground plane from the body's origin."""
    in_view: bool = True
    """Region of interest: only objects whose center a camera of the rig sees, where the rig has cameras."""
    distance_m: float = 2.0
    """3D boxes match when their centers are this near in the ground plane."""
    iou: float = 0.5
    """2D boxes match from this intersection over union on."""
    regions: tuple[str, ...] = ()
    """Region of interest: only objects in the log's regions of these kinds, such as `road`; all where empty."""
    seen: int = 0
    """Region of interest: only objects that some sensor of the log sees, as its truth tells: with so many points of a
    LiDAR or radar, or in an image; 0: all.
    """
    cameras: tuple[str, ...] = ()
    """Images in which boxes are scored; all where empty."""

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

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What tells it apart from the other scores of a run: metric, class, slice and matching."""
        return self.metric, self.class_, self.slice, self.matching

    def __post_init__(self) -> None:
        if self.value is not None and not math.isfinite(self.value):
            raise MetricError(f"{self._where}: {self.value} isn't a number, use null and a reason")
        if (self.value is None) != (self.reason is not None):
            raise MetricError(f"{self._where}: a reason goes with null and only with null")
        if self.low is None and self.high is None:
            return
        ends = [end for end in (self.low, self.high) if end is not None]
        if len(ends) == 1 or not all(map(math.isfinite, ends)) or ends != sorted(ends) or not self.interval:
            raise MetricError(f"{self._where}: {self.low} to {self.high} isn't an interval")

    @property
    def _where(self) -> str:
        return f"score {self.metric} ({self.matching})"


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
    replace_text(path, _dump_rows(scores) + "\n")


_NAMES = tuple((f.name, "class" if f.name == "class_" else f.name) for f in fields(Score))
_encode = json.JSONEncoder(allow_nan=False).encode
_encode_counts = json.JSONEncoder(allow_nan=False, separators=(",\n   ", ": ")).encode


def _dump_rows(scores: Sequence[Score]) -> str:
    """Return what `json.dumps` gives for `score_rows` with `indent=1`, for which Python has no encoder in C."""
    known: dict[object, str] = {}  # Few texts and counts are many scores'

    def encode(value: object) -> str:
        if not isinstance(value, str):
            return "null" if value is None else _encode(value)
        if value not in known:
            known[value] = _encode(value)
        return known[value]

    def encode_counts(counts: Mapping[str, int | float]) -> str:
        if id(counts) not in known:
            known[id(counts)] = f"{{\n   {_encode_counts(dict(counts))[1:-1]}\n  }}" if counts else "{}"
        return known[id(counts)]

    rows = []
    for score in scores:
        values = [
            f'"{name}": {encode_counts(score.counts) if own == "counts" else encode(value)}'
            for own, name in _NAMES
            if (value := getattr(score, own)) is not None or own not in _OF_INTERVALS
        ]
        rows.append(" {\n  " + ",\n  ".join(values) + "\n }")
    return "[\n" + ",\n".join(rows) + "\n]" if rows else "[]"


def score_rows(scores: Sequence[Score]) -> list[dict[str, object]]:
    """Return scores as they stand in `scores.json`; nothing is said of intervals where none was asked for."""
    rows: list[dict[str, object]] = []
    for score in scores:
        row = {name: getattr(score, own) for own, name in _NAMES}
        for name in _OF_INTERVALS:
            if row[name] is None:
                del row[name]
        row["counts"] = dict(score.counts)
        rows.append(row)
    return rows


def load_scores(path: Path) -> list[Score]:
    """Read what `save_scores` wrote. Raises RunError where the file is missing or isn't a list of scores."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return [Score(**{("class_" if k == "class" else k): v for k, v in row.items()}) for row in rows]
    except FileNotFoundError:
        raise RunError(f"{path}: no scores, run `fbench score {path.parent}`") from None
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise RunError(f"{path}: not a list of scores ({error})") from error


Kind: TypeAlias = Literal["share", "change", "count", "ms"]
"""A ratio, shown in percent; a relative change, shown in percent with its sign; a number of things; milliseconds."""
DASH = "–"


@dataclass(frozen=True)
class Figure:
    """One number, or why there is none."""

    value: float | None
    reason: str | None = None
    counts: Mapping[str, int | float] = field(default_factory=dict)
    """Raw counts that it comes from."""
    published: float | None = None
    """The same number as the source system's authors give it."""
    low: float | None = None
    """Ends of the confidence interval, where there is one."""
    high: float | None = None


@dataclass(frozen=True)
class Line:
    """One configuration in one space."""

    name: str
    space: str
    """Such as `image` or `3D`; empty where it plays no part."""
    figures: tuple[Figure, ...]
    """One a column."""


@dataclass(frozen=True)
class Column:
    """What the figures below each other are."""

    name: str
    kind: Kind = "share"


@dataclass(frozen=True)
class ResultTable:
    """A table with a title, and what must be known to read it."""

    name: str
    """Short, for machines."""
    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()
    is_map: bool = False
    """Whether the columns are conditions, and all figures are of one metric from 0 to 1."""

    @property
    def has_spaces(self) -> bool:
        """Whether lines say in which space they are."""
        return any(line.space for line in self.lines)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why numbers are missing, each reason once with what it is about."""
        about: dict[str, list[str]] = {}
        for line in self.lines:
            for column, figure in zip(self.columns, line.figures, strict=True):
                if figure.reason is not None:
                    where = " ".join(part for part in (line.name, line.space) if part)
                    about.setdefault(figure.reason, []).append(f"{column.name} of {where}")
        return tuple(f"{', '.join(names)}: {reason}" for reason, names in about.items())


@dataclass(frozen=True)
class Curves:
    """How one metric, 0 to 1, of several configurations goes over a few steps."""

    title: str
    steps: tuple[str, ...]
    """What is along, such as `clear`, `1` to `5`."""
    lines: tuple[Line, ...]
    """A configuration each, with a figure a step."""


@dataclass(frozen=True)
class Results:
    """All that an experiment gave."""

    title: str
    facts: tuple[tuple[str, str], ...]
    """What ran: name and text."""
    tables: tuple[ResultTable, ...]
    measured: tuple[ResultTable, ...] = ()
    """Tables of times, which differ from run to run."""
    problems: tuple[str, ...] = ()
    """What failed or was left out, and why."""
    curves: tuple[Curves, ...] = ()


def format_number(value: float | None, kind: Kind) -> str:
    """A number as people read it; an en dash for none."""
    if value is None:
        return DASH
    if kind in ("count", "ms"):
        return f"{value:.0f}" if kind == "count" else f"{value:.2f}"
    text = f"{100 * value:+.1f}" if kind == "change" else f"{100 * value:.1f}"
    return text.lstrip("+-") if float(text) == 0 else text


def format_count(num: int, noun: str, plural: str = "", is_estimate: bool = False) -> str:
    """A number of things: `1 frame`, `2 frames`; `plural` where it isn't the noun with an s: `2 boxes`. An estimate is
    marked: `≈2 frames`.
    """
    return f"{'≈' if is_estimate else ''}{num} {noun if num == 1 else plural or f'{noun}s'}"


def format_figure(figure: Figure, kind: Kind) -> str:
    """A number with its interval in brackets, where it has one: `-12.5 (-15.1 to -9.8)`."""
    text = format_number(figure.value, kind)
    if figure.low is None or figure.high is None:
        return text
    return f"{text} ({format_number(figure.low, kind)} to {format_number(figure.high, kind)})"


def curve_rows(curves: Curves) -> list[dict[str, object]]:
    """Return the figures of curves as rows for JSON: a line a step, named by title and step; columns are lines."""
    return [
        row
        for line in curves.lines
        for step, figure in zip(curves.steps, line.figures, strict=True)
        for row in table_rows(
            ResultTable("", "", (Column(line.name),), (Line(f"{curves.title} {step}", line.space, (figure,)),))
        )
    ]


def table_rows(table: ResultTable) -> list[dict[str, object]]:
    """Return a table's figures as rows for JSON."""
    return [
        {"name": line.name, "space": line.space, "column": column.name, "value": figure.value,
         "reason": figure.reason, "published": figure.published, "counts": dict(figure.counts),
         **({} if figure.low is None else {"low": figure.low, "high": figure.high})}
        for line in table.lines
        for column, figure in zip(table.columns, line.figures, strict=True)
    ]  # fmt: skip
