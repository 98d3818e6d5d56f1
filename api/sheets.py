"""Contact sheets of runs: which runs are shown, which frame, and from where its pictures come."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

from fbench.api.reports import is_suite
from fbench.api.scores import open_folder, open_folders
from fbench.api.sides import open_results
from fbench.api.suites.cells import CELLS
from fbench.api.suites.suite import LOGS
from fbench.datasets.city.spec import CONDITIONS
from fbench.metrics.comparison.cells import CellSide
from fbench.replay.conditions.disturb import DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes
from fbench.replay.data.scores import format_count
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.frames import FrameStream
from fbench.replay.logs.open import find_logs, open_log
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import ConditionEntry
from fbench.replay.runs.media import MediaFrame, keep
from fbench.replay.runs.redaction import public_id
from fbench.replay.setup.request import make_disturbance
from fbench.replay.setup.source import LogRequest, log_source
from fbench.reports.sheet import Cell, Sheet, draw_sheet, require_drawable

_CLEAR = "clear"
_ORDER = (
    "camera2d", "lidar2d", "radar2d", "early2d", "late2d", "lidar3d", "radar3d", "stereo3d", "early3d", "late3d",
)  # fmt: skip
"""Rows of a suite: single sensors before fusion, images before space."""


@dataclass(frozen=True)
class SheetRequest:
    """What is drawn, from what."""

    runs: Sequence[Path | str]  # Run folders, or one suite's folder
    out: Path  # `.png` or `.svg`
    frame: int | None = None  # Index; `None`: the frame with the most truth
    log: Path | None = None  # A log, or a folder of logs, for runs that kept no pictures


@dataclass(frozen=True)
class SheetSummary:
    """What was drawn."""

    frame: int
    num_rows: int
    num_columns: int
    scene: str
    notes: Sequence[str] = ()  # What isn't shown, and why


@dataclass(frozen=True, eq=False)
class SheetPlan:
    """What will be drawn; nothing of it is yet."""

    request: SheetRequest
    scene: str
    cells: Mapping[tuple[str, str], Run]  # By row and column
    index: int  # Of the frame
    sources: Mapping[str, MediaFrame | Path | None]  # By column, in its order: pictures that a run kept, or the log
    notes: Sequence[str]


def sheet(request: SheetRequest) -> SheetSummary:
    """Draw one frame of all pipelines under all conditions; of several scenes the one with the most runs.

    Raises:
        ConfigError: where there are no such runs, no such frame, the log isn't that of the runs, or nothing can be
            written.
        LogError: where the log can't be read.
        MissingPackageError: without matplotlib.
        RunError: where a run is damaged.
    """
    return draw(plan_sheet(request))


def plan_sheet(request: SheetRequest) -> SheetPlan:
    """Choose runs, frame and logs, and draw nothing. Raises as `sheet`, which does both."""
    require_drawable(request.out)
    named, notes = _open_runs(request.runs)
    scene, cells = _choose_scene(named)
    columns = list(dict.fromkeys(column for _, column in cells))
    columns.sort(key=lambda name: list(CONDITIONS).index(name) if name in CONDITIONS else len(CONDITIONS))
    logs = _Logs(request)
    by_column = {column: [run for (_, own), run in cells.items() if own == column] for column in columns}
    kept = {column: _merge_media(runs) for column, runs in by_column.items()}
    paths = {column: None if kept[column] and request.log is None else logs.find(runs[0])
             for column, runs in by_column.items()}  # fmt: skip
    pictures = [(kept[c], by_column[c]) for c in columns if kept[c] and paths[c] is None]
    index = _choose_frame(request.frame, [*cells.values()], pictures)
    sources, bare = dict[str, MediaFrame | Path | None](), list[str]()
    for column, runs in by_column.items():
        sources[column] = paths[column] or kept[column].get(index) or logs.find(runs[0])
        if sources[column] is None and _with_frame(runs, index):
            bare.append(column)
    if bare:
        notes.append(f"no pictures of {', '.join(bare)}: the runs kept none of frame {index}; name the log with --log")
    return SheetPlan(request, scene, cells, index, sources, tuple(notes))


def draw(plan: SheetPlan) -> SheetSummary:
    """Draw what was chosen. Raises as `sheet`."""
    rows, index = list(dict.fromkeys(row for row, _ in plan.cells)), plan.index
    media: dict[str, MediaFrame | None] = {}
    for column, source in plan.sources.items():
        runs = _with_frame([run for (_, own), run in plan.cells.items() if own == column], index)
        media[column] = (_from_log(source, runs[0], index) if runs else None) if isinstance(source, Path) else source
    cells = {key: Cell(run, media[key[1]]) for key, run in plan.cells.items()}
    draw_sheet(Sheet(f"{plan.scene}, frame {index}", index, rows, [*media], cells), plan.request.out)
    return SheetSummary(index, len(rows), len(media), plan.scene, plan.notes)


def _open_runs(folders: Sequence[Path | str]) -> tuple[list[tuple[str, Run]], list[str]]:
    """Return runs with the names of their rows, and what of a suite isn't shown: parts of logs that are there whole."""
    if not is_suite(folders):
        return [(run.manifest.pipeline, run) for run in open_folders(folders)], []
    suite = Path(folders[0])
    if (suite / CELLS).is_file():
        cells = [(name, cell.run) for name, cell in open_results(suite).cells.items() if isinstance(cell, CellSide)]
        paces = [f" x{name.rate}" if name.rate not in ("", "max") else "" for name, _ in cells]
        named = [(name.pipeline + pace, run) for (name, run), pace in zip(cells, paces, strict=True) if run]
    else:
        found = sorted(path.parent for path in suite.rglob("manifest.json"))
        runs = [open_folder(folder) for folder in found if not any(part.startswith(".") for part in folder.parts)]
        named = [(run.manifest.pipeline, run) for run in runs]
    if not named:
        raise ConfigError(f"{suite}: has no runs to draw")
    names = [run.manifest.pipeline.rpartition("/")[2] for _, run in named]
    order = [_ORDER.index(name) if name in _ORDER else len(_ORDER) for name in names]
    named = [named[i] for i in sorted(range(len(named)), key=order.__getitem__)]
    whole = [(row, run) for row, run in named if run.manifest.frames.excerpt == str(Excerpt())] or named
    num = len(named) - len(whole)
    return whole, [f"{format_count(num, 'run')} of a part of a log; name run folders to see parts"] if num else []


def _choose_scene(named: Sequence[tuple[str, Run]]) -> tuple[str, dict[tuple[str, str], Run]]:
    """Return the scene with the most cells, the first of several, and its runs by row and condition."""
    scenes: dict[str, list[tuple[str, Run]]] = {}
    for row, run in {run.folder.resolve(): (row, run) for row, run in named}.values():
        scenes.setdefault(_scene(run), []).append((row, run))
    scene, own = max(scenes.items(), key=lambda item: len(item[1]))
    return scene, _name_cells(own)


def _name_cells(named: Sequence[tuple[str, Run]]) -> dict[tuple[str, str], Run]:
    """Return the runs of a scene by row and condition. One pipeline with several settings has a row for each, called
    after what differs in their paths.
    """
    seeds = {run.manifest.seed for _, run in named if run.manifest.conditions}
    keys = [
        (row, _condition(run) + (f" (seed {run.manifest.seed})" if len(seeds) > 1 and run.manifest.conditions else ""))
        for row, run in named
    ]
    several = {row for (row, _), num in Counter(keys).items() if num > 1}
    for row in sorted(several):
        own = [i for i, key in enumerate(keys) if key[0] == row]
        columns, paths = [keys[i][1] for i in own], [named[i][1].folder.resolve() for i in own]
        levels = zip_longest(*(path.parts[::-1] for path in paths), fillvalue="")  # the folders' own names first
        parts = next((names for names in levels if len({*zip(names, columns, strict=True)}) == len(own)), None)
        for i, part in zip(own, parts or map(str, paths), strict=True):
            keys[i] = (part if row.rpartition("/")[2] in part else f"{row} {part}", keys[i][1])
    return {key: run for key, (_, run) in zip(keys, named, strict=True)}


def _scene(run: Run) -> str:
    """What conditions are compared on: the drive of a simulation, else the log."""
    log = run.manifest.log
    names = [log.metadata.get(key, "") for key in ("scenario", "seed")]
    return "-".join(names) if all(names) else log.name


def _condition(run: Run) -> str:
    """Under what a log was recorded, and what disturbed it then."""
    recorded = run.manifest.log.metadata.get("condition", _CLEAR)
    applied = [str(entry) for entry in run.manifest.conditions]
    return " + ".join([*([] if applied and recorded == _CLEAR else [recorded]), *applied])


def _merge_media(runs: Sequence[Run]) -> dict[int, MediaFrame]:
    """Return what any of the runs kept: a pipeline keeps what its own sensors measured."""
    found: dict[int, MediaFrame] = {}
    for run in runs:
        for frame in run.media:
            old = found.get(frame.index, MediaFrame(frame.index))
            pictures, points = {**frame.pictures, **old.pictures}, {**frame.points, **old.points}
            found[frame.index] = replace(old, pictures=pictures, points=points)
    return found


def _choose_frame(
    wanted: int | None, runs: Sequence[Run], pictures: Sequence[tuple[Mapping[int, MediaFrame], Sequence[Run]]]
) -> int:
    """Return the wanted frame, else of those that most runs have, and whose pictures runs kept, if any, the first with
    the most truth. `pictures`: of columns without a log, and their runs.
    """
    nums = Counter(frame.index for run in runs for frame in run.frames)
    if not nums:
        raise ConfigError("the runs have no frames")
    if wanted is not None:
        if wanted not in nums:
            raise ConfigError(f"--frame {wanted}: expected one that the runs have: {min(nums)} to {max(nums)}")
        return wanted
    least = min(len(runs) // 2 + 1, max(nums.values()))
    there = sorted(index for index, num in nums.items() if num >= least)
    drawn = [index for index in there if all(index in media or not _with_frame(own, index) for media, own in pictures)]
    longest = sorted(runs, key=lambda run: -len(run.frames))
    return max(drawn or there, key=lambda index: _num_truth(_with_frame(longest, index)[0], index))


def _with_frame(runs: Sequence[Run], index: int) -> list[Run]:
    return [run for run in runs if any(frame.index == index for frame in run.frames)]


def _num_truth(run: Run, index: int) -> int:
    boxes: Boxes | None = run.truth3d(index)
    if boxes is None:
        boxes = run.truth2d(index)
    if boxes is None:
        return 0
    return len(boxes) if boxes.ignore is None else int((~boxes.ignore).sum())


class _Logs:
    """The logs to draw from, looked for when one is needed: those that the user names, else those of the suite."""

    def __init__(self, request: SheetRequest) -> None:
        suite = Path(request.runs[0])
        self._places = [place for place in (suite, suite / LOGS) if is_suite(request.runs) and place.is_dir()]
        if request.log is not None:
            self._places = [request.log]
        self._is_named = request.log is not None

    def find(self, run: Run) -> Path | None:
        """Return the log that was replayed. Raises ConfigError where the user named only others."""
        entry = run.manifest.log
        for path in self._paths(entry.name):
            info = open_log(path, FaultLog()).info
            if entry.log_id in (info.log_id, public_id(info)):
                return path
        if self._is_named:
            raise ConfigError(
                f"{self._places[0]}: has no log of {run.folder}, which is '{entry.name}', id {entry.log_id}"
            )
        return None

    def _paths(self, name: str) -> Iterator[Path]:
        """Yield those of a name first: the others need be opened only where it was changed."""
        found: list[Path] = []
        for place in self._places:
            if not place.exists():
                raise ConfigError(f"--log {place}: no such log, nor folder of logs")
            found += find_logs(place)
        yield from sorted(found, key=lambda path: path.stem != name)


def _from_log(path: Path, run: Run, index: int) -> MediaFrame:
    """Read a frame as the run got it, disturbed where that was."""
    manifest, faults, source = run.manifest, FaultLog(), log_source(LogRequest(path))
    how = manifest.frames
    disturbance = make_disturbance(source, "+".join(map(_text, manifest.conditions)), manifest.seed or 0)
    reader = source.open(faults)
    log = DisturbedReader(reader, disturbance, Effects()) if disturbance else reader
    sync = SyncParams(how.reference, how.timeout_ns, how.tolerance_ns, how.max_gap_ns, how.max_jump_ns)
    stamps = StampParams("log" if how.stamps == "log" else "header", how.offsets_ns)
    stream = FrameStream(log, sync, stamps, Excerpt(index, index + 1), Clock(), faults)
    frame = next(stream.frames(log), None)
    expected = next(record.stamp_ns for record in run.frames if record.index == index)
    if frame is None or frame.stamp_ns != expected:
        raise ConfigError(f"{path}: frame {index} isn't that of {run.folder}; was it replayed with other options?")
    return keep(disturbance.rig(stream.rig, reader.info.log_id), frame)


def _text(entry: ConditionEntry) -> str:
    """A condition as `--condition` has it."""
    scope = f".{entry.sensors}" if entry.sensors else ""
    begin, end = ("" if seconds is None else f"{seconds!r}s" for seconds in (entry.from_s, entry.to_s))
    return f"{entry.name}{scope}:{entry.strength}" + (f"@{begin}-{end}" if begin or end else "")


def describe(summary: SheetSummary, out: Path) -> list[str]:
    """Say what was drawn, and what wasn't."""
    cells = f"{format_count(summary.num_rows, 'pipeline')} x {format_count(summary.num_columns, 'condition')}"
    return [
        f"sheet: {out} ({cells}, {summary.scene}, frame {summary.frame})",
        *(f"not shown: {n}" for n in summary.notes),
    ]
