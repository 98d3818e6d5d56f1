"""The thesis's tables 9.4 and 9.5 from the scores of an experiment's runs, beside the published figures."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from fbench.metrics.core.bootstrap import LEAST_UNITS
from fbench.metrics.latency import nearest_rank
from fbench.metrics.robustness.scenes import CLEAR, HOW, ScoredRun, Space, change, difference, pool, spaces_of
from fbench.replay.data.scores import Column, Figure, Line, ResultTable


@dataclass(frozen=True)
class Published:
    """One configuration; all are ratios."""

    f1: float
    mota_no_fp: float  # The thesis calls it MOTA; it leaves out false positives
    change: Mapping[str, float]  # Relative change of F1 against the normal condition, by condition


def _figures(f1: float, mota: float, traffic: float, rain: float, fog: float, night: float) -> Published:
    changes = {"traffic": traffic, "rain": rain, "fog": fog, "dense-fog": fog, "night": night}
    return Published(f1 / 100, mota / 100, {name: value / 100 for name, value in changes.items()})


_CAMERA = _figures(68.24, 61.43, -12.37, -24.82, -37.64, -41.29)
_LIDAR = _figures(71.51, 67.86, -9.41, -18.56, -22.34, -27.18)
_RADAR = _figures(67.66, 49.14, -6.27, -8.43, -10.18, -14.92)
_CONFIGURATIONS: Mapping[tuple[str, Space], Published] = {
    ("camera2d", "image"): _CAMERA,
    ("lidar2d", "image"): _LIDAR,
    ("lidar3d", "3D"): _LIDAR,
    ("radar2d", "image"): _RADAR,
    ("radar3d", "3D"): _RADAR,
    ("early2d", "image"): _figures(82.32, 74.65, -7.52, -13.78, -17.46, -20.31),
    ("early3d", "3D"): _figures(80.71, 78.27, -6.48, -12.29, -15.63, -18.44),
    ("late2d", "image"): _figures(85.16, 79.42, -5.36, -10.72, -12.58, -15.27),
    ("late3d", "3D"): _figures(83.58, 82.66, -4.29, -8.65, -10.41, -12.16),
}
PUBLISHED: Mapping[tuple[str, Space], Published] = {
    **_CONFIGURATIONS, **{(f"thesis/{name}", space): own for (name, space), own in _CONFIGURATIONS.items()},
}  # fmt: skip
"""By pipeline and space, as `NOTES` say: ours, then the thesis's as written."""
NOTES = (
    "The thesis has one figure for each configuration and doesn't say in which space: it stands beside the space of "
    + "the configuration's own boxes alone, the image for those in 2D, 3D for those in 3D.",
    "Its LiDAR only and radar only stand beside the 2D and the 3D configuration both; of its early 3D it doesn't say "
    + "whether stereo is in it: its figures stand beside those without.",
    "How dense its fog is the thesis doesn't say: its figure stands beside fog and dense fog both.",
)
"""What who reads both must know."""
_NAMES = (
    "camera2d", "lidar2d", "lidar3d", "radar2d", "radar3d", "stereo3d", "early2d", "early2d-rgbd", "early3d",
    "early3d-stereo", "late2d", "late2d-stereo", "late2d-filter", "late3d", "late3d-filter",
)  # fmt: skip
_SINGLE = ("camera2d", "lidar2d", "lidar3d", "radar2d", "radar3d")
_FUSED = ("early2d", "early3d", "late2d", "late3d")
_PAIRS = (
    ("early2d", "late2d"), ("early3d", "late3d"), ("early3d-stereo", "early3d"), ("late2d-stereo", "late2d"),
)  # fmt: skip
"""What is compared besides: early with late fusion, and fusion with stereo and without."""
_PREFIXES = ("", "thesis/")
ORDER = tuple(prefix + name for prefix in _PREFIXES for name in _NAMES)
"""Of configurations, as the thesis has them; those without figures have their place, too."""
_ACCURACY = (Column("F1"), Column("MOTA"), Column("MOTA w/o FP"), Column("truth boxes", "count"))
_NOTES = (
    "F1 is of detections, MOTA of tracks, all vehicles as one class; counts are added over scenes before dividing.",
    "MOTA w/o FP leaves out false positives: it is what the thesis calls MOTA.",
)
_TOTAL = "total"


def configurations(runs: Sequence[ScoredRun]) -> list[str]:
    """Return the configurations of runs in the thesis's order, those that it doesn't have last."""
    names = sorted({run.configuration for run in runs})
    return sorted(names, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name))


def _names(name: str, title: str, region: bool) -> tuple[str, str]:
    """Name and title of a table; of the same that counts only what is on road and sidewalk (thesis, 9.3.3)."""
    return (f"{name}_region", f"{title}, road and sidewalk only, %") if region else (name, f"{title}, %")


def _interval_note(runs: Sequence[ScoredRun]) -> tuple[str, ...]:
    """How intervals are made, and which conditions have too few scenes for them."""
    scenes = {name: {run.scene for run in runs if run.condition == name} for name in {r.condition: 0 for r in runs}}
    few = [f"{name} ({len(own)})" for name, own in scenes.items() if len(own) < LEAST_UNITS]
    notes = []
    if len(few) < len(scenes):
        notes.append(
            f"Behind each figure: {100 * HOW.share:g} % of {HOW.num} bootstrap resamples of the scenes, the same ones "
            "for all configurations and conditions."
        )
    if few:
        notes.append(f"No intervals where there are fewer than {LEAST_UNITS} scenes: {', '.join(few)}.")
    return tuple(notes)


def accuracy_table(runs: Sequence[ScoredRun], *, region: bool = False) -> ResultTable:
    """Return table 9.4: F1 and MOTA in clear weather with intervals, a line for each configuration and space; the runs
    are scored on road and sidewalk only where `region` says so.
    """
    clear = [run for run in runs if run.condition == CLEAR]
    lines = []
    for own, space in _groups(clear):
        f1, mota, no_fp = (pool(own, metric, space, HOW) for metric in ("f1", "mota", "mota_no_fp"))
        published = PUBLISHED.get((own[0].configuration, space))
        if published is not None:
            f1, no_fp = replace(f1, published=published.f1), replace(no_fp, published=published.mota_no_fp)
        truth = Figure(f1.counts["tp"] + f1.counts["fn"]) if f1.counts else Figure(None, f1.reason)
        lines.append(Line(own[0].configuration, space, (f1, mota, no_fp, truth)))
    notes = (*_NOTES, *_interval_note(clear), *_notes_on_thesis(lines))
    name, title = _names("accuracy", "Accuracy in clear weather (table 9.4)", region)
    return ResultTable(name, title, _ACCURACY, tuple(lines), notes)


def gain_table(runs: Sequence[ScoredRun], conditions: Sequence[str], *, region: bool = False) -> ResultTable:
    """Return by how many points of F1 each fusion is ahead of the best single input, early of late fusion, and fusion
    with stereo of the same without: a column for each condition, and a note on what is within its interval.

    The best input is that of clear weather among those with boxes of the same kind, in images or in space.
    """
    lines, within = [], list[str]()
    for space in spaces_of(runs):
        by_name = {own[0].configuration: own for own, where in _groups(runs) if where == space}
        clear = {name: [run for run in own if run.condition == CLEAR] for name, own in by_name.items()}
        for head, base in _comparisons(clear, space):
            figures = []
            for condition in conditions:
                ours, theirs = ([run for run in by_name[name] if run.condition == condition] for name in (head, base))
                figures.append(difference(ours, theirs, space, HOW))
            lines.append(Line(f"{head} over {base}", space, tuple(figures)))
            level = [
                name for name, f in zip(conditions, figures, strict=True)
                if f.low is not None and f.high is not None and f.low <= 0 <= f.high
            ]  # fmt: skip
            within += [f"{head} over {base}, {space} ({', '.join(level)})"] if level else []
    notes = [
        "Points of F1; the best input is that of clear weather, with boxes of the same kind.",
        *_interval_note(runs),
    ]
    if within:
        notes.append(f"Not significant, as the interval holds 0: {'; '.join(within)}.")
    name, title = _names("gain", "F1 of fusion minus that of its best input, and of fusions compared", region)
    return ResultTable(name, title, tuple(Column(c, "change") for c in conditions), tuple(lines), tuple(notes))


def _comparisons(clear: Mapping[str, Sequence[ScoredRun]], space: Space) -> Iterator[tuple[str, str]]:
    """Pairs of configurations that were scored in one space."""
    for prefix in _PREFIXES:
        for name in (name for name in _FUSED if prefix + name in clear):
            own = [prefix + single for single in _SINGLE if single[-2:] == name[-2:]]
            f1 = {single: pool(clear.get(single, ()), "f1", space).value for single in own}
            inputs = {single: value for single, value in f1.items() if value is not None}
            if inputs:
                yield prefix + name, max(inputs, key=lambda single: (inputs[single], single))
        yield from ((prefix + a, prefix + b) for a, b in _PAIRS if prefix + a in clear and prefix + b in clear)


def robustness_table(
    runs: Sequence[ScoredRun], conditions: Sequence[str], *, region: bool = False, notes: Sequence[str] = ()
) -> ResultTable:
    """Return table 9.5: relative change of F1 against clear weather with intervals, a column for each condition."""
    names, lines = [name for name in conditions if name != CLEAR], []
    for own, space in _groups(runs):
        published = PUBLISHED.get((own[0].configuration, space))
        figures = [change(own, name, space, HOW) for name in names]
        if published is not None:
            figures = [replace(f, published=published.change.get(n)) for f, n in zip(figures, names, strict=True)]
        lines.append(Line(own[0].configuration, space, tuple(figures)))
    columns = tuple(Column(name, "change") for name in names)
    said = ("Relative: -50 is half of the F1 in clear weather.", *_interval_note(runs), *notes)
    name, title = _names("robustness", "Change of F1 against clear weather (table 9.5)", region)
    return ResultTable(name, title, columns, tuple(lines), (*said, *_notes_on_thesis(lines)))


def disturbance_table(runs: Sequence[ScoredRun], conditions: Sequence[str], notes: Sequence[str]) -> ResultTable:
    """Return table 9.5 for other disturbances, on runs of their own: light, and sensors that drop out or are late."""
    table = robustness_table(runs, conditions, notes=notes)
    title = "Change of F1 under other disturbances (table 9.5), %"
    return replace(table, name="disturbances", title=title)


def condition_table(runs: Sequence[ScoredRun], conditions: Sequence[str], *, region: bool = False) -> ResultTable:
    """Return F1 in each condition, with intervals."""
    lines = tuple(
        Line(own[0].configuration, space,
             tuple(pool([run for run in own if run.condition == name], "f1", space, HOW)
                   for name in conditions))
        for own, space in _groups(runs)
    )  # fmt: skip
    name, title = _names("f1_by_condition", "F1 by condition", region)
    return ResultTable(name, title, tuple(map(Column, conditions)), lines, _interval_note(runs), is_map=True)


def latency_table(timings: Mapping[str, Sequence[Mapping[str, Sequence[int]]]]) -> ResultTable:
    """Return the median wall time of each stage, a line for each stage and a column for each configuration.

    `timings` are, for each configuration, of each of its runs the times [ns] by stage, without frames of warm-up.
    """
    times = {
        name: {stage: [ns for own in runs for ns in own.get(stage, ())] for run in runs for stage in run}
        for name, runs in timings.items()
    }
    longest_first = sorted(times.values(), key=len, reverse=True)  # has most of them in their order
    stages = [name for name in dict.fromkeys(name for own in longest_first for name in own) if name != _TOTAL]
    lines = []
    for stage in (*stages, _TOTAL):
        figures = []
        for own in times.values():
            ranked = sorted(own.get(stage, []))
            value, num = nearest_rank(ranked, 50) / 1e6 if ranked else None, len(ranked)
            figures.append(
                Figure(
                    value, None if num else "no such stage" if stage not in own else "no frame is left", {"frames": num}
                )
            )
        lines.append(Line(stage, "", tuple(figures)))
    columns = tuple(Column(name, "ms") for name in times)
    return ResultTable("latency", "Latency by stage, median in clear weather, ms", columns, tuple(lines))


def _groups(runs: Sequence[ScoredRun]) -> list[tuple[list[ScoredRun], Space]]:
    """The runs of each configuration, in each space in which they were scored; image first."""
    own = {name: [run for run in runs if run.configuration == name] for name in configurations(runs)}
    found = [(own[name], space) for space, name in product(spaces_of(runs), own)]
    return [(members, space) for members, space in found if space in spaces_of(members)]


def _notes_on_thesis(lines: Sequence[Line]) -> tuple[str, ...]:
    return NOTES if any(figure.published is not None for line in lines for figure in line.figures) else ()
