"""Scores of one run, and of several runs of one pipeline together: counts are added, ratios taken of the sums."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import TypeVar

from fbench.metrics.core.bootstrap import Bootstrap, with_intervals
from fbench.metrics.core.slices import VEHICLE, ScoreCounts, add_counts
from fbench.metrics.detection.horizon import HORIZONS
from fbench.metrics.detection.scores import DetectionCounts
from fbench.metrics.runs import detection, tracking
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.tracking.scores import TrackingCounts
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.plugins import guard
from fbench.replay.contracts.profiles import Match, Statistics
from fbench.replay.contracts.protocols import AddsCounts, Metric
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.formats.text import is_number
from fbench.replay.runs.folder import Run

_ORDER = (
    "f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw", "idf1", "hota", "best_f1", "best_f1_threshold",
    "ap", *HORIZONS, "deta", "assa", "loca", "idp", "idr", "frag", "mt", "pt", "ml", "occlusion_survival",
    "distance_error", "range_rate_error",
)  # fmt: skip


def score_run(run: Run, options: ScoreOptions, metrics: Sequence[Metric]) -> list[Score]:
    """Return the rows of all metrics, primary rows first.

    All vehicles as one class come first, in the pipeline's own space, then in the image; then single labels; then
    slices; then what isn't about a class. Inside these, detection before tracking; rows of other metrics keep their
    order. Raises MetricError where truth or results can't be scored.
    """
    shared = run if isinstance(run, SharedRun) else SharedRun(run.folder)
    return _sort_rows([row for metric in metrics for row in metric.scores(shared, options)])


def _sort_rows(rows: Sequence[Score]) -> list[Score]:
    # The first row of these metrics is in the pipeline's own space.
    native = next((row.matching for row in rows if row.metric in ("f1", "mota")), "")
    classes = list(dict.fromkeys(row.class_ for row in rows))
    slices = list(dict.fromkeys(row.slice for row in rows))

    def rank(row: Score) -> tuple[int, int, int]:
        metric = _ORDER.index(row.metric) if row.metric in _ORDER else len(_ORDER)
        if row.slice != "all":
            return 3, slices.index(row.slice), metric
        if row.class_ == VEHICLE.name:
            return int(row.matching != native), 0, metric
        return (4, 0, metric) if row.class_ == "all" else (2, classes.index(row.class_), metric)

    return sorted(rows, key=rank)


S = TypeVar("S", bound=Statistics)
_ALWAYS = ("log", "scenario", "condition")
_LONGEST_WORD = 40
RATES = ("f1", "precision", "recall", "mota", "mota_no_fp", "motp", *HORIZONS, "distance_error", "range_rate_error")
"""What depends on single steps, or nearly: MOTA also on what came one step before."""
OF_TRACKS = ("idf1", "idp", "idr", "hota", "deta", "assa", "loca", "occlusion_survival")  # What depends on whole tracks


@dataclass(frozen=True)
class RunTable:
    """Statistics of one run, or of several added."""

    detection: tuple[ScoreCounts[DetectionCounts], ...]
    tracking: tuple[ScoreCounts[TrackingCounts], ...]
    matching: str  # In the pipeline's own space
    num_scored: int  # Frames that have truth
    num_frames: int

    def __add__(self, other: "RunTable") -> "RunTable":
        return RunTable(
            add_counts([self.detection, other.detection]), add_counts([self.tracking, other.tracking]), self.matching,
            self.num_scored + other.num_scored, self.num_frames + other.num_frames,
        )  # fmt: skip

    def rows(self) -> list[Score]:
        """Return all rows, primary ones first."""
        rows = [row for entry in self.detection for row in detection.rows_of(entry)]
        rows += [row for entry in self.tracking for row in tracking.rows_of(entry)]
        return _sort_rows([*rows, detection.coverage(self.matching, self.num_scored, self.num_frames)])

    def as_part(self, part: str) -> "RunTable":
        """Return the whole of it as a slice of something larger."""

        def name(entries: tuple[ScoreCounts[S], ...]) -> tuple[ScoreCounts[S], ...]:
            whole = (entry for entry in entries if entry.key.slice == "all")
            return tuple(replace(entry, key=replace(entry.key, slice=part)) for entry in whole)

        return replace(self, detection=name(self.detection), tracking=name(self.tracking))


@dataclass(frozen=True)
class RunStatistics:
    """What must be known of a run to score it with others."""

    key: tuple[str, str, str]  # Name and id of the log, and the digest of what came out
    pipeline: str
    tags: Mapping[str, str]  # `log`, and the words of its metadata: scenario, condition ...
    table: RunTable
    others: Sequence[tuple[Metric, Sequence[Score]]] = ()  # Rows of metrics that aren't fbench's own


def measure_run(
    run: Run, options: ScoreOptions, match: Match | None = None, metrics: Sequence[Metric] = ()
) -> RunStatistics:
    """Measure one run with truth; keeps nothing of it but counts, and the rows of those `metrics` that aren't fbench's
    own. A `match` stands instead of that of the options, see `views`. Raises MetricError where an id occurs twice in
    one frame. Raises ConfigError where the options ask for regions that the log hasn't.
    """
    manifest, shared = run.manifest, SharedRun(run.folder)
    found = detection.detection_entries(shared, options, match)
    tracked = tracking.tracking_entries(shared, options, match)
    native, words = found[0].key, manifest.log.metadata
    # No numbers, and no texts as long as that of regions.
    tags = {key: value for key, value in words.items() if 0 < len(value) <= _LONGEST_WORD and not is_number(value)}
    return RunStatistics(
        (manifest.log.name, manifest.log.log_id, manifest.digest), manifest.pipeline,
        {"log": manifest.log.name, **tags},
        RunTable(found, tracked, native.matching, native.num_frames, len(shared.frames)),
        [(m, m.scores(shared, options)) for m in metrics if not isinstance(m, detection.Detection | tracking.Tracking)],
    )  # fmt: skip


def combine_runs(runs: Iterable[RunStatistics], how: Bootstrap | None = None) -> list[Score]:
    """Return the rows of all runs added, then those of each log, scenario, condition and other word by which they
    differ, as slices such as `condition fog`.

    Runs are of one pipeline, in any order; with resamples of them, `how`, all together have confidence intervals. So
    has what depends on single steps under each condition. Raises MetricError where there is no run, runs are of several
    pipelines, or one is there twice; ConfigError where runs count different boxes in the pipeline's own space.
    """
    known = sorted(runs, key=lambda run: run.key)
    if not known:
        raise MetricError("no run to score")
    pipelines = sorted({run.pipeline for run in known})
    if len(pipelines) > 1:
        raise MetricError(f"runs of several pipelines ({', '.join(pipelines)}) can't be scored together; compare them")
    twice = [key for key, num in Counter(run.key for run in known).items() if num > 1]
    if twice:
        raise MetricError(f"the run of '{pipelines[0]}' on log '{twice[0][0]}' is there twice; give it once")
    # Counts of different boxes aren't added: some rigs have cameras, in whose view truth must be, others don't.
    matchings: dict[str, str] = {}
    for run in known:
        if run.table.matching in _matchings(run):
            matchings.setdefault(run.table.matching, run.tags["log"])
    if len(matchings) > 1:
        (one, first), (other, second) = list(matchings.items())[:2]
        is_view = one.replace(", in view", "") == other.replace(", in view", "")
        advice = "--all-around leaves cameras out" if is_view else "score them apart"
        which = f"'{one}' on log '{first}', '{other}' on log '{second}'"
        raise ConfigError(f"runs count different boxes: {which}; {advice}")
    if how is None:
        rows = reduce(add, (run.table for run in known)).rows()
    else:
        rows = resample({"\n".join(run.key): run.table for run in known}, how, "logs", (*RATES, *OF_TRACKS))
    rows = _sort_rows([*rows, *_add_others(known)])
    for part, members in _parts(known):
        own = [row for row in reduce(add, (run.table for run in members)).as_part(part).rows() if row.slice != "all"]
        if how is not None and part.startswith(detection.CONDITION):
            found = resample({"\n".join(run.key): run.table for run in members}, how, "logs", RATES)
            own = copy_intervals((replace(row, slice=part) for row in found if row.slice == "all"), own)
        rows += own
        rows += [replace(row, slice=part) for row in _add_others(members) if row.slice == "all"]
    return rows


def _add_others(runs: Sequence[RunStatistics]) -> list[Score]:
    """The rows of other metrics: as they are where one run has them, else with their counts added."""
    found: dict[tuple[type[Metric], tuple[str, str, str, str]], list[tuple[Metric, Score]]] = {}
    for metric, row in ((metric, row) for run in runs for metric, own in run.others for row in own):
        found.setdefault((type(metric), row.key), []).append((metric, row))
    total = []
    for (kind, key), own in found.items():
        (metric, first), *_ = own
        if len(own) == 1:
            total.append(first)
            continue
        names = dict.fromkeys(name for _, row in own for name in row.counts)
        counts = {name: sum(row.counts.get(name, 0) for _, row in own) for name in names}
        value, reason = None, f"{kind.__name__} doesn't say what counts of several runs give (value_of)"
        if isinstance(metric, AddsCounts):
            with guard(f"metric '{kind.__name__}' can't add runs"):
                value = metric.value_of(first.metric, counts) if counts else None  # no run knows anything
            reason = next((row.reason for _, row in own if row.reason is not None), "undefined")
        total.append(Score(*key, value, reason if value is None else None, first.unit, counts))
    return total


def _matchings(run: RunStatistics) -> list[str]:
    """How boxes match in the spaces in which a run has something to score."""
    keys = (entry.key for entry in run.table.detection)
    return list(dict.fromkeys(key.matching for key in keys if key.reason is None))


def _parts(runs: Sequence[RunStatistics]) -> Iterator[tuple[str, list[RunStatistics]]]:
    """Each value of each tag by which runs differ; but for log, scenario, condition only what several share."""
    others = sorted({key for run in runs for key in run.tags} - set(_ALWAYS))
    for tag in (*_ALWAYS, *others):
        values = Counter(run.tags.get(tag) for run in runs)
        if len(values) < 2 or (tag not in _ALWAYS and max(values.values()) < 2):
            continue
        for value in sorted(v for v in values if v is not None):
            yield f"{tag} {value}", [run for run in runs if run.tags.get(tag) == value]


def describe_gaps(runs: Sequence[RunStatistics]) -> list[str]:
    """Say which rows only some of the runs scored together have, as those in images where a rig has no cameras."""
    logs: dict[str, list[str]] = {}
    for run in runs:
        for matching in _matchings(run):
            logs.setdefault(matching, []).append(run.tags["log"])
    return [
        f"rows by '{matching}' are of {len(held)} of {len(runs)} runs only: {', '.join(held)}"
        for matching, held in logs.items()
        if len(held) < len(runs)
    ]


def resample(tables: Mapping[str, RunTable], how: Bootstrap, unit: str, metrics: Sequence[str]) -> list[Score]:
    """Return the rows of all tables added, those of these metrics about all boxes of a class with intervals."""
    no_curve = DetectionCounts().ranking  # Curves would take long to resample.
    bare = {
        name: [replace(entry, counts=replace(entry.counts, ranking=no_curve)) for entry in table.detection]
        for name, table in tables.items()
    }
    tracks = {name: table.tracking for name, table in tables.items()}
    found = [
        *_resample_entries(bare, detection.rows_of, DetectionCounts(), how, unit, metrics),
        *_resample_entries(tracks, tracking.rows_of, TrackingCounts(), how, unit, metrics),
    ]
    return copy_intervals(found, reduce(add, (tables[name] for name in sorted(tables))).rows())


def _resample_entries(
    tables: Mapping[str, Sequence[ScoreCounts[S]]], rows_of: Callable[[ScoreCounts[S]], list[Score]], nothing: S,
    how: Bootstrap, unit: str, metrics: Sequence[str],
) -> Iterator[Score]:  # fmt: skip
    """Yield the rows of each class and space with intervals; a unit that lacks a class has nothing of it."""
    for total in add_counts(tables[name] for name in sorted(tables)):
        if total.key.slice != "all" or total.key.reason is not None:
            continue
        own = {name: {entry.place: entry.counts for entry in table} for name, table in tables.items()}
        units = {name: counts.get(total.place, nothing) for name, counts in own.items()}

        def rows(counts: S, total: ScoreCounts[S] = total) -> list[Score]:
            return rows_of(ScoreCounts(total.key, counts))

        yield from with_intervals(units, rows, how, unit, metrics)


def copy_intervals(found: Iterable[Score], rows: Iterable[Score]) -> list[Score]:
    """Return rows with the intervals that were found for them."""
    known = {row.key: row for row in found}
    return [
        replace(row, low=own.low, high=own.high, interval=own.interval) if (own := known.get(row.key)) else row
        for row in rows
    ]
