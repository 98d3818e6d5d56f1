"""One import: every chosen sequence of a dataset becomes a log, whole or not at all."""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from fbench.replay.data import LogInfo
from fbench.replay.errors import ConfigError, FbenchError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.imports.ahead import ahead
from fbench.replay.imports.check import checked_items
from fbench.replay.imports.claim import claimed
from fbench.replay.imports.items import LogItems
from fbench.replay.imports.wish import BadInput, ImportWish
from fbench.replay.logs.convert.items import Item, RigAt
from fbench.replay.logs.convert.open_sink import open_sink
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.convert.write import Converted, write_items
from fbench.replay.logs.header import LogHeader, header_of
from fbench.replay.logs.open import open_container
from fbench.replay.protocols import Importer, Recording

Progress = Callable[[str, int, int], None]
"""Is told the name of a sequence, how many of its items are done, and about how many there are."""
_SKIPS = "import.skip_bad"
"""Metadata of logs that may lack what couldn't be used."""


@dataclass(frozen=True)
class ImportedLog:
    """What became of one sequence."""

    name: str
    path: Path
    state: Literal["written", "there", "failed"]
    """`there`: an equal import wrote it before; `failed`: it can't be imported, and bad input is skipped."""
    written: Converted | None = None
    lines: Sequence[str] = ()
    """What was found and what was odd, where it was written."""
    num_skipped: int = 0
    """Files, rows and frames that couldn't be used, where such are skipped."""


def import_recordings(
    importer: Importer,
    source: Path,
    wish: ImportWish,
    targets: Mapping[str, Target],
    progress: Progress = lambda name, done, total: None,
) -> Iterator[ImportedLog]:
    """Import the sequences of a wish one after the other, each into the target of its name.

    A log that an equal import wrote before is left as it is, so that one that was interrupted goes on. Imports that run
    at the same time wait for each other where they write the same log.

    Raises:
        ConfigError: where a log can't or mustn't be written.
        LogError: naming the file that can't be used; the logs before it are whole.
    """
    to_come = dict.fromkeys(wish.names)
    num_before = 0
    with closing(_opened(importer, source, wish)) as recordings:
        for recording in recordings:
            if recording.name not in to_come:
                raise LogError(f"{source}: the importer gives '{recording.name}', which isn't wanted (any more)")
            del to_come[recording.name]
            log = _tried(recording, targets[recording.name], progress, wish.bad)
            yield replace(log, num_skipped=wish.bad.num - num_before)
            num_before = wish.bad.num
    for name in to_come:
        if not wish.bad.num:
            raise LogError(f"{source}: the importer left out '{name}'")
        yield ImportedLog(name, targets[name].path, "failed")


def import_one(importer: Importer, source: Path, out: Path, wish: ImportWish | None = None) -> ImportedLog:
    """Import a sequence, the only one unless a wish names it, into the log `out`, which is replaced.

    Raises:
        ConfigError: where there are several, or the log can't be written.
        LogError: naming the file that can't be used.
    """
    wish = wish or ImportWish(tuple(importer.names(source)))
    if len(wish.names) != 1:
        raise ConfigError(f"{source}: expected one sequence, there are {len(wish.names)}")
    return next(import_recordings(importer, source, wish, {wish.names[0]: Target(out, overwrite=True)}))


def write_recording(recording: Recording, target: Target, progress: Progress) -> ImportedLog:
    """Write one sequence, or leave the log that an equal one wrote before.

    Raises:
        ConfigError: where the log can't or mustn't be written.
        LogError: naming what can't be used of the sequence.
    """
    with claimed(target.path, lambda: progress(f"{recording.name} (waiting for another import)", 0, 0)):
        return _imported(recording, target, progress, skips=False)


def _opened(importer: Importer, source: Path, wish: ImportWish) -> Generator[Recording]:
    try:
        yield from importer.recordings(source, wish)
    except LogError as error:
        wish.bad.met(error)


def _tried(recording: Recording, target: Target, progress: Progress, bad: BadInput) -> ImportedLog:
    try:
        with claimed(target.path, lambda: progress(f"{recording.name} (waiting for another import)", 0, 0)):
            return _imported(recording, target, progress, bad.skip)
    except LogError as error:
        bad.met(error)
        return ImportedLog(recording.name, target.path, "failed")


def _imported(recording: Recording, target: Target, progress: Progress, skips: bool) -> ImportedLog:
    name, info = recording.name, recording.info
    if skips:
        info = replace(info, metadata={**info.metadata, _SKIPS: "yes"})
    if not target.overwrite and _is_there(target.path, info):
        return ImportedLog(name, target.path, "there")
    target.require_free()
    total = recording.num_items
    sink = open_sink(target, header_of(info, recording.rig))
    written = write_items(_items(recording), sink, target, lambda num: progress(name, num, total), info.log_id)
    return ImportedLog(name, target.path, "written", written, recording.summary())


def _is_there(path: Path, info: LogInfo) -> bool:
    """Whether an equal import wrote a log.

    Raises:
        ConfigError: where another one did.
    """
    header = _header(path)
    if header is None:
        return False
    if header.log_id != info.log_id:
        raise ConfigError(
            f"{path}: exists already, and is another log (other files, frames or parameters); choose another with "
            "--out, or --overwrite it"
        )
    if _SKIPS in header.metadata and _SKIPS not in info.metadata:
        raise ConfigError(f"{path}: exists already, imported with --skip-bad; say that again, or --overwrite it")
    return True


def holds_log(path: Path, log_id: str) -> bool:
    """Whether a log of this id is there."""
    header = _header(path)
    return header is not None and header.log_id == log_id


def _header(path: Path) -> LogHeader | None:
    """What the log that is there says about itself; `None` where there is no log of fbench."""
    if not path.exists():
        return None
    try:
        return open_container(path, FaultLog()).header
    except FbenchError:
        return None


def _items(recording: Recording) -> Iterator[Item]:
    rig = recording.rig
    yield RigAt(0, rig)
    items = LogItems()
    for imported in checked_items(recording.name, rig, ahead(iter(recording.items()))):
        try:
            yield from items.of(imported)
        except ValueError as error:
            raise LogError(f"{recording.name}: a result can't be stored ({error})") from error
