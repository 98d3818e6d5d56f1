"""One import: every chosen sequence of a dataset becomes a log, whole or not at all."""

import fcntl
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeVar

from fbench.replay.contracts.errors import ConfigError, FbenchError, LogError, output_error
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import ImportRequest, OtherResult, check_items
from fbench.replay.contracts.protocols import Importer, Recording
from fbench.replay.data.arrays import own_arrays
from fbench.replay.data.files import Draft, make_folder
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import LogInfo, RigChange
from fbench.replay.logs.codecs.codec import TruthPart, split_truth
from fbench.replay.logs.codecs.foxglove.topics import BOXES2D, BOXES3D, message_topic
from fbench.replay.logs.container import Entry, LogHeader, header_of
from fbench.replay.logs.convert.run import Converted, write_items
from fbench.replay.logs.convert.sinks import Copied, Decoded, Item, RigAt, encode_result, open_sink
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_container

T = TypeVar("T")
Progress = Callable[[str, int, int], None]
"""Gets the name of a sequence, how many of its items are done, and about how many there are."""
NUM_AHEAD = 4  # Items; both sides take about as long, so that more wouldn't hide more
_SKIPS = "import.skip_bad"  # Metadata of logs that may lack what couldn't be used


@contextmanager
def claim(path: Path, waits: Callable[[], None]) -> Iterator[None]:
    """Have the log `path` alone while the `with` block runs, without what is left half written; `waits` is called where
    another import has it. The system gives a claim back when its process ends, however it does. Raises ConfigError
    where nothing can be written beside the log.
    """
    lock = path.with_name(f".{path.name}.importing")
    try:
        make_folder(path.parent)
        number = _lock(lock, waits)
    except OSError as error:
        raise output_error(path, error) from error
    try:
        Draft(path).discard()  # puts back a log that was to be replaced, and wasn't yet
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(number)


def _lock(lock: Path, waits: Callable[[], None]) -> int:
    while True:
        number = os.open(lock, os.O_RDWR | os.O_CREAT)
        try:
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                waits()
                fcntl.flock(number, fcntl.LOCK_EX)
            with suppress(FileNotFoundError):  # who had the claim before may have taken the name away
                if os.path.samestat(os.fstat(number), lock.stat()):
                    return number
        except BaseException:
            os.close(number)
            raise
        os.close(number)


class _End:  # Stands behind the last item
    pass


def read_ahead(items: Iterator[T]) -> Generator[T]:
    """Yield the same items, up to `NUM_AHEAD` of which are asked for before they are wanted.

    All are asked for in one thread, one after the other. An error comes in the place of its item. Who may leave items
    unread has to close it: left to the garbage collector, it could be told to wait for its thread in that very thread.
    """
    waiting: deque[Future[T | _End]] = deque()
    with ThreadPoolExecutor(1, "fbench-import") as pool:
        try:
            waiting.extend(pool.submit(next, items, _End()) for _ in range(NUM_AHEAD))
            while not isinstance(item := waiting.popleft().result(), _End):
                waiting.append(pool.submit(next, items, _End()))
                yield item
        finally:
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class ImportedLog:
    """What became of one sequence."""

    name: str
    path: Path
    state: Literal["written", "there", "failed"]
    """`there`: an equal import wrote it before; `failed`: it can't be imported, and bad input is skipped."""
    written: Converted | None = None
    lines: Sequence[str] = ()  # What was found and what was odd, where it was written
    num_skipped: int = 0  # Files, rows and frames that couldn't be used, where such are skipped


def import_recordings(
    importer: Importer,
    source: Path,
    request: ImportRequest,
    targets: Mapping[str, Target],
    progress: Progress = lambda name, done, total: None,
) -> Iterator[ImportedLog]:
    """Import the sequences of a request one after the other, each into the target of its name.

    A log that an equal import wrote before is left as it is, so that one that was interrupted goes on. Imports that run
    at the same time wait for each other where they write the same log. Raises ConfigError where a log can't or mustn't
    be written. Raises LogError naming the file that can't be used; the logs before it are whole.
    """
    to_come = dict.fromkeys(request.names)
    num_before = 0
    with closing(_open_recordings(importer, source, request)) as recordings:
        for recording in recordings:
            if recording.name not in to_come:
                raise LogError(f"{source}: the importer gives '{recording.name}', which isn't wanted (any more)")
            del to_come[recording.name]
            target = targets[recording.name]
            try:
                log = write_recording(recording, target, progress, request.bad.skip)
            except LogError as error:
                request.bad.report(error)
                log = ImportedLog(recording.name, target.path, "failed")
            yield replace(log, num_skipped=request.bad.num - num_before)
            num_before = request.bad.num
    for name in to_come:
        if not request.bad.num:
            raise LogError(f"{source}: the importer left out '{name}'")
        yield ImportedLog(name, targets[name].path, "failed")


def import_one(importer: Importer, source: Path, out: Path, request: ImportRequest | None = None) -> ImportedLog:
    """Import a sequence, the only one unless a request names it, into the log `out`, which is replaced.

    Raises ConfigError where there are several, or the log can't be written. Raises LogError naming the file that can't
    be used.
    """
    request = request or ImportRequest(tuple(importer.names(source)))
    if len(request.names) != 1:
        raise ConfigError(f"{source}: expected one sequence, there are {len(request.names)}")
    return next(import_recordings(importer, source, request, {request.names[0]: Target(out, overwrite=True)}))


def write_recording(recording: Recording, target: Target, progress: Progress, skips: bool = False) -> ImportedLog:
    """Write one sequence, or leave the log that an equal one wrote before; `skips` says that bad input is left out.
    Raises ConfigError where the log can't or mustn't be written. Raises LogError naming what can't be used.
    """
    name = recording.name
    with claim(target.path, lambda: progress(f"{name} (waiting for another import)", 0, 0)):
        info = recording.info
        if skips:
            info = replace(info, metadata={**info.metadata, _SKIPS: "yes"})
        if not target.overwrite and _is_there(target.path, info):
            return ImportedLog(name, target.path, "there")
        target.require_free()
        total = recording.num_items
        sink = open_sink(target, header_of(info, recording.rig))
        with closing(_items(recording)) as items:
            written = write_items(items, sink, target, lambda num: progress(name, num, total), info.log_id)
        return ImportedLog(name, target.path, "written", written, recording.summary())


def _open_recordings(importer: Importer, source: Path, request: ImportRequest) -> Generator[Recording]:
    try:
        yield from importer.recordings(source, request)
    except LogError as error:
        request.bad.report(error)


def _is_there(path: Path, info: LogInfo) -> bool:
    """Whether an equal import wrote a log. Raises ConfigError where another one did."""
    header = _header(path)
    if header is None:
        return False
    if header.log_id != info.log_id:
        what = "exists already, and is another log (other files, frames or parameters)"
        raise ConfigError(f"{path}: {what}; choose another with --out, or --overwrite it")
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


def _items(recording: Recording) -> Generator[Item]:
    rig = recording.rig
    yield RigAt(0, rig)
    with closing(read_ahead(map(own_arrays, recording.items()))) as ahead:
        for imported in check_items(recording.name, rig, ahead):
            match imported:
                case RigChange():
                    yield RigAt(imported.log_ns, imported.rig)
                case Truth():
                    for part in split_truth(imported):
                        yield Decoded(BOXES2D if part.is_2d else BOXES3D, imported.log_ns, part)
                case OtherResult():
                    # A topic without any box would be taken for the results where there are only those in images.
                    for part in split_truth(imported.boxes):
                        if part.is_2d or part.truth.boxes3d is not None:
                            yield _encode_result(recording.name, part, imported.boxes.log_ns)
                case _:
                    yield Decoded(message_topic(imported), imported.log_ns, imported)


def _encode_result(name: str, part: TruthPart, log_ns: int) -> Copied:
    try:
        encoded = encode_result(part)
    except ValueError as error:
        raise LogError(f"{name}: a result can't be stored ({error})") from error
    channel, data = encoded.channel, memoryview(encoded.data)
    return Copied(channel, Entry(log_ns, channel.topic, 0, 0, 0, 0, encoded.sequence, encoded.publish_ns, data))
