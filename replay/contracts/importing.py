"""Types of importers: what is requested of a dataset, what a recording consists of, and the checks of both."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import get_args

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
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

    def met(self, error: LogError) -> None:
        """Skip what an error tells of.

        Raises:
            LogError: that error, where nothing is to be skipped.
        """
        if not self.skip:
            raise error
        self.num += 1
        if len(self.texts) < self.keep:
            self.texts.append(str(error))


@dataclass(frozen=True)
class ImportWish:
    """What an import is asked for."""

    names: tuple[str, ...]
    """The sequences, in the order in which the importer named them."""
    frames: FrameRange = field(default_factory=FrameRange)
    """Of each sequence."""
    bad: BadInput = field(default_factory=BadInput)


def chosen_names(names: Sequence[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the names that fit any of the patterns (`*` and `?` as in file names), all without patterns.

    Raises:
        ConfigError: for a pattern that fits none.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigError(f"--scenes {pattern}: no such sequence{_known(pattern, names)}")
    return tuple(name for name in names if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns))


def _known(pattern: str, names: Sequence[str]) -> str:
    hint = did_you_mean(pattern, names)
    return hint if len(hint) < 300 else f"; there are {len(names)}, {names[0]} to {names[-1]}"


_MAX_NS = 2**63 - 1
_KINDS: dict[type[Message], Kind] = {Image: "camera", PointCloud: "lidar", RadarScan: "radar"}


def checked_items(name: str, rig: Rig, items: Iterable[Imported]) -> Iterator[Imported]:
    """Pass on the items of the sequence `name`, at least one, which fit the rig and are in the order of `log_ns`.

    Raises:
        LogError: for the first item that doesn't, or where there is none.
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
    match item:
        case RigChange():
            return item.log_ns, item.log_ns
        case OtherResult():
            return item.boxes.log_ns, item.boxes.stamp_ns
        case _:
            return item.log_ns, item.stamp_ns


def _what(item: Imported) -> str:
    match item:
        case Image() | PointCloud() | RadarScan() | Pose():
            return f"{type(item).__name__} of '{item.sensor}'"
        case Truth() | OtherResult() | RigChange():
            return type(item).__name__
    return "an item"
