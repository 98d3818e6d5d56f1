"""One conversion: open, move item by item, close."""

from dataclasses import dataclass, field, replace

from fbench.replay.excerpt import Excerpt
from fbench.replay.logs.container import Container
from fbench.replay.logs.convert.copying import Copying
from fbench.replay.logs.convert.decoding import Decoding
from fbench.replay.logs.convert.exact import InexactError, candidates
from fbench.replay.logs.convert.open_sink import open_sink
from fbench.replay.logs.convert.source import Source
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.convert.write import Converted, Progress, write_items
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import Setup


@dataclass(frozen=True)
class Wish:
    """What of a log is wanted, and how."""

    topics: tuple[str, ...] = ()
    """Patterns."""
    excerpt: Excerpt = field(default_factory=Excerpt)
    """A range of time, by `log_ns`."""
    decode: bool = False
    """Everything becomes fbench's own messages; what fbench doesn't understand is left out."""
    setup: Setup = field(default_factory=Setup)
    """What the user says about the log, where it is decoded."""


def convert(
    container: Container, target: Target, wish: Wish, progress: Progress = lambda num_messages: None
) -> Converted:
    """Write a log in another form.

    Nothing is lost: what isn't decoded stays as it is, byte for byte. The container counts what is damaged.

    Raises:
        ConfigError: where the target can't or mustn't be written, or the wish fits nothing.
        LogError: where the source can't be read.
    """
    target.check(container.path)
    return (_decoded if wish.decode else _copied)(container, target, wish, progress)


def _copied(container: Container, target: Target, wish: Wish, progress: Progress) -> Converted:
    source = Source(container, wish.topics, wish.excerpt)
    as_columns = candidates(container, source.reader.roles) if target.form == "parquet" else frozenset[int]()
    while True:
        copying = Copying(source, as_columns)
        about = source.about if target.form == "mcap" or not copying.rigs else replace(source.about, kinds={})
        try:
            return write_items(copying.items(), open_sink(target, about), target, progress, about.log_id)
        except InexactError as error:
            as_columns -= {error.channel}


def _decoded(container: Container, target: Target, wish: Wish, progress: Progress) -> Converted:
    reader = LogReader(container, wish.topics, wish.setup)
    decoding = Decoding(reader, Source(container, (), wish.excerpt).window)
    sink = open_sink(target, decoding.about)
    written = write_items(decoding.items(), sink, target, progress, decoding.about.log_id)
    return replace(written, left_out=dict(sorted(decoding.left_out.items())))
