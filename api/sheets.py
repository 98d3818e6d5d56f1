"""Contact sheets of runs: which runs are shown, which frame, and from where its pictures come."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fbench.api.reports import is_suite
from fbench.api.scores import open_folder
from fbench.api.suites.suite import LOGS
from fbench.datasets.city.spec import CONDITIONS
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
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import ConditionEntry
from fbench.replay.runs.media import MediaFrame, keep
from fbench.replay.runs.redaction import public_id
from fbench.replay.setup.request import make_disturbance
from fbench.replay.setup.source import LogRequest, log_source
from fbench.reports.sheet import Cell, Sheet, draw_sheet

_CLEAR = "clear"
_LOGS = (".mcap", ".parquet", ".bag")
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


def sheet(request: SheetRequest) -> SheetSummary:
    """Draw one frame of all pipelines under all conditions; of several scenes the one with the most runs.

    Raises:
        ConfigError: where there are no such runs, no such frame, the log isn't that of the runs, or nothing can be
            written.
        LogError: where the log can't be read.
        MissingPackageError: without matplotlib.
        RunError: where a run is damaged.
    """
    scene, named = _choose_scene(_open_runs(request.runs))
    rows, columns = (list(dict.fromkeys(key[i] for key in named)) for i in (0, 1))
    columns.sort(key=lambda name: list(CONDITIONS).index(name) if name in CONDITIONS else len(CONDITIONS))
    logs = _Logs(request)
    by_column = {column: [run for (_, own), run in named.items() if own == column] for column in columns}
    kept = {column: _merge_media(runs) for column, runs in by_column.items()}
    paths = {column: None if kept[column] and request.log is None else logs.find(runs[0])
             for column, runs in by_column.items()}  # fmt: skip
    index = _choose_frame(request.frame, by_column, [kept[c] for c in columns if kept[c] and paths[c] is None])
    media: dict[str, MediaFrame | None] = {}
    for column, runs in by_column.items():
        path = paths[column] or (None if index in kept[column] else logs.find(runs[0]))
        media[column] = kept[column].get(index) if path is None else _from_log(path, runs[0], index)
    cells = {key: Cell(run, media[key[1]]) for key, run in named.items()}
    draw_sheet(Sheet(f"{scene}, frame {index}", index, rows, columns, cells), request.out)
    bare = [column for column in columns if media[column] is None]
    notes = [f"no pictures of {', '.join(bare)}: the runs kept none of frame {index}; name the log with --log"]
    return SheetSummary(index, len(rows), len(columns), scene, notes if bare else ())


def _open_runs(folders: Sequence[Path | str]) -> list[Run]:
    if not is_suite(folders):
        return [open_folder(Path(folder)) for folder in folders]
    found = sorted(path.parent for path in Path(folders[0]).rglob("manifest.json"))
    runs = [open_folder(folder) for folder in found if not any(part.startswith(".") for part in folder.parts)]
    if not runs:
        raise ConfigError(f"{folders[0]}: has no runs to draw")
    names = [run.manifest.pipeline.rpartition("/")[2] for run in runs]
    order = [_ORDER.index(name) if name in _ORDER else len(_ORDER) for name in names]
    return [runs[i] for i in sorted(range(len(runs)), key=order.__getitem__)]


def _choose_scene(runs: Sequence[Run]) -> tuple[str, dict[tuple[str, str], Run]]:
    """Return the scene with the most cells, the first of several, and its runs by pipeline and condition."""
    scenes: dict[str, dict[tuple[str, str], Run]] = {}
    for run in runs:
        cells, key = scenes.setdefault(_scene(run), {}), (run.manifest.pipeline, _condition(run))
        if key in cells:  # one pipeline with several settings
            key = (f"{key[0]} {'/'.join(run.folder.resolve().parts[-2:])}", key[1])
        cells[key] = run
    return max(scenes.items(), key=lambda item: len(item[1]))


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


def _choose_frame(wanted: int | None, runs: dict[str, list[Run]], kept: Sequence[dict[int, MediaFrame]]) -> int:
    """Return the wanted frame, else of those that can be drawn everywhere, if any, the first with the most truth."""
    first = next(iter(runs.values()))[0]
    there = [frame.index for frame in first.frames]
    for run in (run for own in runs.values() for run in own):
        have = {frame.index for frame in run.frames}
        there = [index for index in there if index in have]
    if wanted is not None:
        if wanted not in there:
            span = f"{there[0]} to {there[-1]}" if there else "none"
            raise ConfigError(f"--frame {wanted}: expected one that all runs have: {span}")
        return wanted
    if not there:
        raise ConfigError("the runs have no frame in common")
    drawn = [index for index in there if all(index in media for media in kept)] or there
    return max(drawn, key=lambda index: _num_truth(first, index))


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
            is_log = place.is_file() or (place / "log.json").is_file()
            found += [place] if is_log else sorted(p for p in place.iterdir() if p.suffix in _LOGS)
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
