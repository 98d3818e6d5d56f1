"""One conversion: open, move item by item, whole or not at all."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fbench.replay.conditions.disturb import Disturbance
from fbench.replay.conditions.effects import Effects
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.logs.container import Container, header_of
from fbench.replay.logs.convert.copying import Copying, InexactError, decode, own_channels
from fbench.replay.logs.convert.disturbing import disturb, disturb_header
from fbench.replay.logs.convert.sinks import Copied, Item, RigAt, Sink, open_sink
from fbench.replay.logs.convert.source import Source
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import Setup

_EVERY = 64  # Progress is told after so many messages
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Converted:
    """What was written."""

    path: Path
    log_id: str
    num_bytes: int
    messages: Mapping[str, int]  # By topic; a rig that is stored as data isn't among them
    num_rigs: int  # How many rigs are stored as data
    parts: tuple[str, ...] = ()  # Names of the files of a log in parts
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Messages that fbench doesn't understand, by topic; only where they were decoded."""
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """What conditions changed, by sensor; see `Effects`."""

    @property
    def num_messages(self) -> int:
        """Messages written on all topics."""
        return sum(self.messages.values())


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
    path = target.path
    num_bytes = sum(file.stat().st_size for file in ([path] if path.is_file() else sorted(path.iterdir())))
    return Converted(path, log_id, num_bytes, dict(sorted(counts.items())), num_rigs, sink.parts)


@dataclass(frozen=True)
class ConvertRequest:
    """What of a log is wanted, and how."""

    topics: tuple[str, ...] = ()  # Patterns
    excerpt: Excerpt = field(default_factory=Excerpt)  # A range of time, by `log_ns`
    decode: bool = False  # Everything becomes fbench's own messages; what fbench doesn't understand is left out
    setup: Setup = field(default_factory=Setup)  # What the user says about the log, where it is decoded
    disturbance: Disturbance = field(default_factory=Disturbance)  # Of the messages, where they are decoded


def convert(
    container: Container, target: Target, request: ConvertRequest, progress: Progress = lambda num_messages: None
) -> Converted:
    """Write a log in another form.

    Nothing is lost: what isn't decoded stays as it is, byte for byte. The container counts what is damaged. Raises
    ConfigError where the target can't or mustn't be written, or the request fits nothing. Raises LogError where the
    source can't be read, or where it is decoded and a sensor has no transform, or a camera isn't calibrated. Raises
    RunError where a condition fails.
    """
    target.check(container.path)
    if request.decode:
        reader = LogReader(container, request.topics, request.setup)
        window = Source(container, (), request.excerpt).window
        about = header_of(reader.info, reader.rig)
        left_out: Counter[str] = Counter()
        effects, disturbance = Effects(), request.disturbance
        items: Iterable[Item] = decode(reader, window, left_out)
        if disturbance:
            about, items = disturb_header(about, disturbance), disturb(items, reader, disturbance, effects)
        written = write_items(items, open_sink(target, about), target, progress, about.log_id)
        return replace(written, left_out=dict(sorted(left_out.items())), effects=effects.rows())
    source = Source(container, request.topics, request.excerpt)
    as_columns = own_channels(container, source.reader.roles) if target.form == "parquet" else frozenset()
    while True:
        copying = Copying(source, as_columns)
        about = source.about if target.form == "mcap" or not copying.rigs else replace(source.about, kinds={})
        try:
            return write_items(copying.items(), open_sink(target, about), target, progress, about.log_id)
        except InexactError as error:
            as_columns -= {error.channel}
