"""Writing the items of a log, whole or not at all."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fbench.replay.logs.convert.items import Copied, Item, RigAt
from fbench.replay.logs.convert.sinks import Sink
from fbench.replay.logs.convert.target import Target

_EVERY = 64
"""Progress is told after so many messages."""
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Converted:
    """What was written."""

    path: Path
    log_id: str
    num_bytes: int
    messages: Mapping[str, int]
    """By topic; a rig that is stored as data isn't among them."""
    num_rigs: int
    """How many rigs are stored as data."""
    parts: tuple[str, ...] = ()
    """Names of the files of a log in parts."""
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Messages that fbench doesn't understand, by topic; only where they were decoded."""


def write_items(items: Iterable[Item], sink: Sink, target: Target, progress: Progress, log_id: str) -> Converted:
    """Move all items; nothing stays behind where that fails."""
    counts: Counter[str] = Counter()
    num_rigs = 0
    try:
        for num, item in enumerate(items):
            sink.put(item)
            if isinstance(item, RigAt):
                num_rigs += 1
            else:
                counts[item.entry.topic if isinstance(item, Copied) else item.topic] += 1
            if num % _EVERY == 0:
                progress(num)
        sink.close()
    finally:
        sink.discard()
    messages = dict(sorted(counts.items()))
    return Converted(target.path, log_id, _size(target.path), messages, num_rigs, sink.parts)


def _size(path: Path) -> int:
    files = [path] if path.is_file() else sorted(path.iterdir())
    return sum(file.stat().st_size for file in files)
