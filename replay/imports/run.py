"""One import: every chosen sequence of a dataset becomes a log, whole or not at all."""

import glob
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fbench.replay.errors import ConfigError, FbenchError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.imports.items import LogItems
from fbench.replay.imports.wish import ImportWish
from fbench.replay.logs.convert.items import Item, RigAt
from fbench.replay.logs.convert.open_sink import open_sink
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.convert.write import Converted, write_items
from fbench.replay.logs.header import header_of
from fbench.replay.logs.open import open_container
from fbench.replay.protocols import Importer, Recording

Progress = Callable[[str, int, int], None]
"""Is told the name of a sequence, how many of its items are done, and about how many there are."""


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


def import_recordings(
    importer: Importer,
    source: Path,
    wish: ImportWish,
    targets: Mapping[str, Target],
    progress: Progress = lambda name, done, total: None,
) -> Iterator[ImportedLog]:
    """Import the sequences of a wish one after the other, each into the target of its name.

    A log that an equal import wrote before is left as it is, so that one that was interrupted goes on.

    Raises:
        ConfigError: where a log can't or mustn't be written.
        LogError: naming the file that can't be used; the logs before it are whole.
    """
    for recording in importer.recordings(source, wish):
        target = targets[recording.name]
        try:
            yield _imported(recording, source, target, progress)
        except LogError as error:
            wish.bad.met(error)
            yield ImportedLog(recording.name, target.path, "failed")


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


def _imported(recording: Recording, source: Path, target: Target, progress: Progress) -> ImportedLog:
    name = recording.name
    _clear_partial(target.path)
    if not target.overwrite and _id_of(target.path) == recording.info.log_id:
        return ImportedLog(name, target.path, "there")
    target.check(source)
    total = recording.num_items
    sink = open_sink(target, header_of(recording.info, recording.rig))
    log_id = recording.info.log_id
    written = write_items(_items(recording), sink, target, lambda num: progress(name, num, total), log_id)
    return ImportedLog(name, target.path, "written", written, recording.summary())


def _items(recording: Recording) -> Iterator[Item]:
    yield RigAt(0, recording.rig)
    items = LogItems()
    for imported in recording.items():
        try:
            yield from items.of(imported)
        except ValueError as error:
            raise LogError(f"{recording.name}: a result can't be stored ({error})") from error


def _id_of(path: Path) -> str | None:
    """Id of the log that is there; `None` where there is none."""
    if not path.exists():
        return None
    try:
        header = open_container(path, FaultLog()).header
    except FbenchError:
        return None
    return None if header is None else header.log_id


def _clear_partial(path: Path) -> None:
    """Remove what an import that was killed has left beside the log."""
    for left in sorted(path.parent.glob(f".{glob.escape(path.name)}.partial-*")):
        number = left.name.rpartition("-")[2]
        if re.fullmatch(r"[0-9]+", number) and not _is_running(int(number)):
            if left.is_dir():
                shutil.rmtree(left)
            else:
                left.unlink(missing_ok=True)


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
