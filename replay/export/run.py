"""One export: runs and logs in, files of a benchmark out."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from fbench.replay.config.source import LogWish, log_source
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.export.classes import require_class
from fbench.replay.export.log_boxes import log_sequence
from fbench.replay.export.place import Draft, Place
from fbench.replay.export.run_boxes import MANIFEST, run_sequence
from fbench.replay.export.sequence import BoxSequence
from fbench.replay.export.wish import ExportWish, LeftOut
from fbench.replay.export.writers import Submission, TextFiles, view_of
from fbench.replay.faults import FaultLog
from fbench.replay.file_names import file_name

Progress = Callable[[str, int, int], None]
"""Is told the name of a sequence, how many of its frames are done, and how many there are."""


@dataclass(frozen=True)
class Exported:
    """What became of one run or log."""

    name: str
    num_frames: int
    num_rows: int
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Boxes that aren't in the files, by the reason."""
    view: str = ""
    """Which image and coordinates they are in."""


@dataclass(frozen=True)
class Export:
    """What is exported, and where to.

    Raises:
        ConfigError: where a class isn't known, or a name is for several sources.
    """

    sources: Sequence[Path]
    """Run folders and logs."""
    wish: ExportWish
    place: Place
    name: str = ""
    """Of the only source, in place of its own."""

    def __post_init__(self) -> None:
        require_class(self.wish)
        if self.name and len(self.sources) != 1:
            raise ConfigError(f"--name {self.name}: is for one source, there are {len(self.sources)}")


def export(job: Export, faults: FaultLog, progress: Progress = lambda name, done, total: None) -> Iterator[Exported]:
    """Export sources one after the other; the files appear when all of them are done.

    Raises:
        ConfigError: where files can't or mustn't be written, or a source isn't there.
        LogError: where the format can't hold what a source has.
        RunError: where a run can't be read.
    """
    job.place.check(job.sources)
    with Draft(job.place) as draft:
        yield from _written(job, draft, faults, progress)
        draft.finish()


def _written(job: Export, draft: Draft, faults: FaultLog, progress: Progress) -> Iterator[Exported]:
    names: dict[str, Path] = {}
    is_only = len(job.sources) == 1
    with Submission(draft) if job.wish.is_nuscenes else TextFiles(draft, is_only) as files:
        for source in job.sources:
            left = LeftOut()
            sequence = _sequence(source, job.wish, left, faults)
            sequence.require_boxes(job.wish.is_tracking)
            name = file_name(job.name or sequence.name)
            if name in names:
                raise ConfigError(f"{source}: is called '{name}' like {names[name]}; export one of them on its own")
            names[name] = source
            exported = _counted(name, sequence, files.add(name, sequence, job.wish, left), left, progress)
            yield replace(exported, view=view_of(sequence, job.wish))


def _sequence(source: Path, wish: ExportWish, left: LeftOut, faults: FaultLog) -> BoxSequence:
    if not source.exists():
        raise ConfigError(f"{source}: no such run folder or log")
    if (source / MANIFEST).is_file():
        return run_sequence(source, wish)
    try:
        return log_sequence(log_source(LogWish(source)), wish, left, faults)
    except LogError as error:
        if error.code == "LOG001":
            raise LogError(f"{error}; and no run folder, which has a {MANIFEST}", error.code) from error
        raise


def _counted(name: str, sequence: BoxSequence, rows: Iterator[int], left: LeftOut, progress: Progress) -> Exported:
    """Write what is to be written, which `rows` does as it goes: the number of rows of each frame or sample."""
    num_rows, num_frames = 0, 0
    for num in rows:
        num_rows, num_frames = num_rows + num, num_frames + 1
        progress(name, num_frames, len(sequence.frames))
    return Exported(name, num_frames, num_rows, dict(sorted(left.counts.items())))
