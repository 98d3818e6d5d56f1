"""Types of importers: what is requested of a dataset, what a recording consists of, the checks of both, and what every
importer needs: files that are read whole, and ids of logs.
"""

import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from hashlib import blake2b
from pathlib import Path
from typing import get_args

from fbench.replay.contracts.errors import ConfigError, LimitError, LogError, did_you_mean
from fbench.replay.contracts.settings import describe
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import Kind, Rig, RigChange


@dataclass(frozen=True, eq=False)
class OtherResult:
    """What another system made of one instant; the pipeline `recorded` reads it."""

    boxes: Truth
    """In body coordinates; 3D and 2D boxes go onto topics of their own."""


Imported = Message | Truth | OtherResult | RigChange


@dataclass(frozen=True)
class FrameRange:
    """A half-open range of frames, as the dataset numbers them."""

    first: int = 0
    stop: int | None = None

    def __contains__(self, number: int) -> bool:
        return self.first <= number and (self.stop is None or number < self.stop)

    def __str__(self) -> str:
        return f"{self.first}:{'' if self.stop is None else self.stop}"

    @property
    def is_whole(self) -> bool:
        """Whether all frames are in it."""
        return self.first == 0 and self.stop is None


@dataclass
class BadInput:
    """Counts files, rows and frames that can't be used; without leave to skip them, the first one ends the import."""

    skip: bool = False
    keep: int = 10
    num: int = 0
    texts: list[str] = field(default_factory=list)
    """The first ones."""

    def report(self, error: LogError) -> None:
        """Skip what an error tells of. Raises LogError: that error, where nothing is to be skipped."""
        if not self.skip:
            raise error
        self.num += 1
        if len(self.texts) < self.keep:
            self.texts.append(str(error))


@dataclass(frozen=True)
class ImportRequest:
    """What an import is asked for."""

    names: tuple[str, ...]
    """The sequences, in the order in which the importer named them."""
    frames: FrameRange = field(default_factory=FrameRange)
    """Of each sequence."""
    bad: BadInput = field(default_factory=BadInput)


def choose_names(names: Sequence[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the names that fit any of the patterns (`*` and `?` as in file names), all without patterns. Raises
    ConfigError for a pattern that fits none.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            hint = did_you_mean(pattern, names)
            known = hint if len(hint) < 300 else f"; there are {len(names)}, {names[0]} to {names[-1]}"
            raise ConfigError(f"--scenes {pattern}: no such sequence{known}")
    return tuple(name for name in names if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns))


_MAX_NS = 2**63 - 1
_KINDS: dict[type[Message], Kind] = {Image: "camera", PointCloud: "lidar", RadarScan: "radar"}


def check_items(name: str, rig: Rig, items: Iterable[Imported]) -> Iterator[Imported]:
    """Pass on the items of the sequence `name`, at least one, which fit the rig and are in the order of `log_ns`.
    Raises LogError for the first item that doesn't, or where there is none.
    """
    last_ns = -1
    for item in items:
        if not isinstance(item, get_args(Imported)):
            raise LogError(f"{name}: its importer gives {type(item).__name__}, which no log can hold")
        log_ns, stamp_ns = times_ns(item)
        if not (0 <= log_ns <= _MAX_NS and 0 <= stamp_ns <= _MAX_NS):
            raise LogError(f"{name}: {_what(item)} at {stamp_ns} ns, recorded at {log_ns}: outside 0 to 2^63 - 1")
        if log_ns < last_ns:
            raise LogError(f"{name}: its importer gives {_what(item)} of {log_ns} ns after something of {last_ns}")
        last_ns = log_ns
        rig = item.rig if isinstance(item, RigChange) else rig
        if isinstance(item, Image | PointCloud | RadarScan):
            kind = _KINDS[type(item)]
            mount = rig.mounts.get(item.sensor)
            if mount is None or mount.kind != kind:
                raise LogError(f"{name}: {_what(item)} comes from a {kind} that the rig lacks")
        yield item
    if last_ns < 0:
        raise LogError(f"{name}: nothing in it to import, are --frames outside of it?")


def times_ns(item: Imported) -> tuple[int, int]:
    """When an item was recorded, and when it was measured."""
    if isinstance(item, RigChange):
        return item.log_ns, item.log_ns
    timed = item.boxes if isinstance(item, OtherResult) else item
    return timed.log_ns, timed.stamp_ns


def _what(item: Imported) -> str:
    name = type(item).__name__
    return f"{name} of '{item.sensor}'" if isinstance(item, Image | PointCloud | RadarScan | Pose) else name


MAX_BYTES = 112 * 2**20  # No file of a dataset that becomes one message is larger


def require_folder(path: Path) -> None:
    """Refuse what isn't a folder. Raises LogError: saying what it is."""
    if not path.is_dir():
        raise LogError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}")


def require_file(path: Path) -> None:
    """Refuse what isn't a file: pipes and devices never end, or never begin. Raises LogError: saying so."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {error.strerror if isinstance(error, OSError) else error}") from error
    if not stat.S_ISREG(mode):
        raise LogError(f"{path}: {'Is a directory' if stat.S_ISDIR(mode) else 'a pipe or device, expected a file'}")


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a file. Raises LogError where it can't be read. Raises LimitError where it is larger than
    `limit` [byte].
    """
    require_file(path)
    try:
        if (size := path.stat().st_size) > limit:
            raise LimitError(f"{path}: {size} bytes, more than {limit}")
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error


def read_text(path: Path, limit: int = MAX_BYTES) -> str:
    """Return the content of a text file. Raises LogError where it can't be read, or isn't UTF-8. Raises LimitError
    where it is larger than `limit` [byte].
    """
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason} at byte {error.start})") from error


def log_id(dataset: str, facts: Iterable[str], frames: FrameRange, params: object = None) -> str:
    """Return the id of a log.

    Args:
        dataset: Short name of the dataset, with which the id begins.
        facts: What tells the source apart, in a fixed order: names and sizes of files (`file_facts`), tokens.
        frames: Which frames were imported.
        params: The importer's parameters.
    """
    digest = blake2b(digest_size=8)
    own = [f"{name}={value}" for name, value in sorted(describe_params(params).items())]
    for text in [*facts, str(frames), *own]:
        data = text.encode(errors="surrogateescape")
        digest.update(len(data).to_bytes(8, "little") + data)
    return f"{dataset}-{digest.hexdigest()}"


def file_facts(root: Path, paths: Iterable[Path]) -> list[str]:
    """Return name below `root` and size of each file; of one that isn't there the name."""
    sizes = ((path, path.stat().st_size if path.is_file() else "missing") for path in paths)
    return [f"{path.relative_to(root).as_posix()} {size}" for path, size in sizes]


def describe_params(params: object) -> Mapping[str, str]:
    """Return an importer's parameters as metadata of the log, `import.NAME`; those that are left open are left out."""
    if params is None:
        return {}
    return {f"import.{name}": str(value) for name, value in describe(params).items() if value not in (None, "")}
