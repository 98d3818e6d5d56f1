"""One export: runs and logs in, files of a benchmark out, all of them at once or none."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.files import Draft, file_name, make_parent
from fbench.replay.data.rig import Kind
from fbench.replay.formats.export_request import TABLES, ExportRequest, LeftOut
from fbench.replay.formats.export_sources import MANIFEST, log_sequence, run_sequence
from fbench.replay.formats.kitti import kitti_rows
from fbench.replay.formats.mot import mot_rows, seqinfo
from fbench.replay.formats.nuscenes import nuscenes_samples
from fbench.replay.formats.sequence import BoxSequence, choose_camera, coordinate_frame
from fbench.replay.setup.source import LogRequest, log_source

_SUFFIXES = (".txt", ".ini")  # Of all that is written into folders
_Add = Callable[[str, BoxSequence, ExportRequest, LeftOut], Iterator[int]]
"""Writes a sequence under a name, and yields the number of rows of each frame."""
Progress = Callable[[str, int, int], None]  # Gets the name of a sequence, how many frames are done, and there are


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _open(path: Path) -> IO[str]:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("w", encoding="utf-8", newline="\n")


def _add_texts(
    folder: Path, is_only: bool, name: str, sequence: BoxSequence, request: ExportRequest, left: LeftOut
) -> Iterator[int]:
    """Write rows: of KITTI `NAME.txt`, or one a frame, in no folder of its own where it is the only sequence; of
    MOTChallenge `NAME.txt`, or of truth `NAME/gt/gt.txt` and `NAME/seqinfo.ini`.
    """
    if request.format == "kitti":
        for number, rows in kitti_rows(sequence, request, left):
            with _open(folder / f"{'' if is_only else f'{name}/'}{number:06d}.txt") as file:
                file.writelines(f"{row}\n" for row in rows)
            yield len(rows)
        return
    frames: Iterator[list[str]] = (rows for _, rows in kitti_rows(sequence, request, left))
    path = folder / f"{name}.txt"
    if request.format == "mot":
        frames = mot_rows(sequence, request, left)
        if sequence.is_truth:
            path = folder / name / "gt" / "gt.txt"
            camera = sequence.rig.cameras.get(choose_camera(sequence, request.camera))
            with _open(folder / name / "seqinfo.ini") as file:
                file.write(seqinfo(name, sequence, camera))
    with _open(path) as file:
        for rows in frames:
            file.writelines(f"{row}\n" for row in rows)
            yield len(rows)


@contextmanager
def _submission(path: Path) -> Iterator[_Add]:
    """The one file of nuScenes, written sample by sample."""
    owners: dict[str, str] = {}
    kinds: set[Kind] = set()

    def add(name: str, sequence: BoxSequence, request: ExportRequest, left: LeftOut) -> Iterator[int]:
        kinds.update(sequence.kinds)
        for token, results in nuscenes_samples(sequence, request, left):
            if token in owners:
                raise LogError(f"{sequence.where}: sample {token} is of {owners[token]} too")
            file.write(f"{',' if owners else ''}\n{json.dumps(token)}: {json.dumps(results, allow_nan=False)}")
            owners[token] = sequence.where
            yield len(results)

    with _open(path) as file:
        file.write('{"results": {')
        yield add
        used = {f"use_{kind}": kind in kinds for kind in ("camera", "lidar", "radar")}
        file.write(f'\n}}, "meta": {json.dumps({**used, "use_map": False, "use_external": False})}}}\n')


@dataclass(frozen=True)
class Exported:
    """What became of one run or log."""

    name: str
    num_frames: int
    num_rows: int
    left_out: Mapping[str, int] = field(default_factory=dict)  # Boxes that aren't in the files, by the reason
    view: str = ""  # Which image and coordinates they are in


@dataclass(frozen=True)
class Export:
    """What is exported, and where to. ConfigError for an unknown class, or one name for several sources."""

    sources: Sequence[Path]  # Run folders and logs
    request: ExportRequest
    out: Path  # A folder; of nuScenes, whose format is one file, that file
    overwrite: bool = False
    name: str = ""  # Of the only source, in place of its own
    decoder: Sequence[str] = ()  # Of messages in logs that fbench doesn't know

    def __post_init__(self) -> None:
        name, table = self.request.class_name, TABLES[self.request.format]
        names = sorted({*table.own.values(), *table.labels.values()} - {""})
        if name and name not in names:
            raise ConfigError(f"--class {name}: no class of {self.request.format}{did_you_mean(name, names)}")
        if self.name and len(self.sources) != 1:
            raise ConfigError(f"--name {self.name}: is for one source, there are {len(self.sources)}")

    def require_free_place(self) -> None:
        """See that nothing else is lost. Raises ConfigError where something is in the way, or it lies in a source."""
        out = self.out.resolve()
        for source in self.sources:
            old = source.resolve()
            if old == out or old in out.parents or out in old.parents:
                raise ConfigError(f"{self.out}: is what is exported, or lies in it or around it; choose another name")
        if self.request.is_nuscenes and self.out.suffix != ".json":
            raise ConfigError(f"{self.out}: this format is one file; expected a name that ends in .json")
        make_parent(self.out)
        is_empty = not self.request.is_nuscenes and _is_folder(self.out) and not any(self.out.iterdir())
        if not (self.out.exists() or self.out.is_symlink()) or is_empty:
            return
        if not self.overwrite:
            raise ConfigError(f"{self.out}: exists already; choose another with --out, or --overwrite it")
        if self.request.is_nuscenes or not _is_folder(self.out):
            is_export = self.request.is_nuscenes and self.out.is_file()
        else:
            is_export = all(_is_folder(p) or (p.is_file() and p.suffix in _SUFFIXES) for p in self.out.rglob("*"))
        if not is_export:
            raise ConfigError(f"{self.out}: exists and holds more than an export, so --overwrite doesn't touch it")


@contextmanager
def _draft(job: Export) -> Iterator[Path]:
    """What is written until it gets its name; nothing is left of it where that doesn't happen."""
    with Draft(job.out, is_folder=not job.request.is_nuscenes) as draft:
        yield draft.path
        draft.publish()


def export(job: Export, faults: FaultLog, progress: Progress = lambda name, done, total: None) -> Iterator[Exported]:
    """Export sources one after the other; the files appear when all are done. Raises ConfigError where files can't or
    mustn't be written, or a source isn't there, LogError where the format can't hold it, RunError where a run can't be
    read.
    """
    job.require_free_place()
    names: dict[str, Path] = {}
    with _draft(job) as draft:
        texts = nullcontext(partial(_add_texts, draft, len(job.sources) == 1))
        with _submission(draft) if job.request.is_nuscenes else texts as add:
            for source in job.sources:
                left = LeftOut()
                sequence = _sequence(LogRequest(source, decoder=job.decoder), job.request, left, faults)
                name = file_name(job.name or sequence.name)
                if name in names:
                    raise ConfigError(f"{source}: is called '{name}' like {names[name]}; export one of them on its own")
                names[name] = source
                num_rows, num_frames = 0, 0
                for num in add(name, sequence, job.request, left):
                    num_rows, num_frames = num_rows + num, num_frames + 1
                    progress(name, num_frames, len(sequence.frames))
                counts = {reason: num for reason, num in sorted(left.items()) if num}
                yield Exported(name, num_frames, num_rows, counts, _describe_view(sequence, job.request))


def _sequence(given: LogRequest, request: ExportRequest, left: LeftOut, faults: FaultLog) -> BoxSequence:
    """Read a run or log that has boxes, with ids where these are needed."""
    source = given.path
    if not source.exists():
        raise ConfigError(f"{source}: no such run folder or log")
    try:
        is_run = (source / MANIFEST).is_file()
        log = None if is_run else log_source(given)
        sequence = run_sequence(source, request) if log is None else log_sequence(log, request, left, faults)
    except LogError as error:
        if error.code == "LOG001" and not is_run:
            raise LogError(f"{error}; and no run folder, which has a {MANIFEST}", error.code) from error
        raise
    if all(frame.boxes3d is None and frame.boxes2d is None for frame in sequence.frames):
        raise LogError(f"{sequence.where}: has no {'truth' if sequence.is_truth else 'boxes'} to export")
    full = sequence.boxes
    if request.is_tracking and full and all(boxes.track_id is None for boxes in full):
        advice = "export tracks with --boxes tracks, or take --format kitti or nuscenes"
        raise LogError(f"{sequence.where}: its boxes have no track ids, which this format needs; {advice}")
    return sequence


def _describe_view(sequence: BoxSequence, request: ExportRequest) -> str:
    """Which image and coordinates the exported boxes of a sequence are in."""
    if request.is_nuscenes:
        return "3D boxes in the world"
    camera = choose_camera(sequence, request.camera)
    has_solids = request.format != "mot" and any(frame.boxes3d is not None for frame in sequence.frames)
    solids = f", 3D boxes in {coordinate_frame(sequence, request.frame, camera)}" if has_solids else ""
    return f"2D boxes in {camera}{solids}"
