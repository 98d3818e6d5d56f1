"""The items of a log as they are: bytes stay bytes, but what fbench wrote may become columns."""

from collections.abc import Iterable, Iterator, Sequence

from fbench.replay.errors import DataError, DecodeError
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.convert.cut import cut, cut_rigs
from fbench.replay.logs.convert.encode import Encoder
from fbench.replay.logs.convert.exact import exactly_decoded
from fbench.replay.logs.convert.items import Copied, Decoded, Item, RigAt, log_ns_of
from fbench.replay.logs.convert.rigs import rig_channels, stored_rigs, told_rigs
from fbench.replay.logs.convert.source import Source


class Copying:
    """All wanted items in canonical order.

    `as_columns` are the channels whose messages are decoded, where that loses nothing; then the rig becomes data too.
    """

    def __init__(self, source: Source, as_columns: frozenset[int]) -> None:
        self._source, self._as_columns = source, as_columns
        self._encoder = Encoder()
        self._channels = source.channels
        self.rigs = stored_rigs(source.container)
        if as_columns and not self.rigs:
            told = told_rigs(source.container, source.reader.roles, self._encoder)
            self.rigs = told or []
            self._channels -= rig_channels(source.reader.roles) if told else frozenset()
        self.rigs = [rig._replace(rig=rig.rig.without(source.gone)) for rig in cut_rigs(self.rigs, source.window)]

    def items(self) -> Iterator[Item]:
        """Read the log once.

        Raises:
            InexactError: where a channel can't become columns.
        """
        entries = self._source.container.entries(self._channels)
        yield from _with_rigs(self.rigs, self._converted(cut(entries, self._source.window, self._source.reader.roles)))

    def _converted(self, entries: Iterable[Entry]) -> Iterator[Copied | Decoded]:
        channels, roles = self._source.container.channels, self._source.reader.roles
        for entry in entries:
            channel = channels[entry.channel]
            if entry.channel in self._as_columns:
                content = exactly_decoded(roles[entry.channel], channel, entry, self._encoder)
                yield Decoded(entry.topic, entry.log_ns, content)
            elif isinstance(entry.data, memoryview):
                yield Copied(channel, entry)
            else:
                yield from _stored(self._source.container, entry)


def _stored(container: Container, entry: Entry) -> Iterator[Decoded]:
    """What a container holds in columns; what doesn't fit together is counted."""
    if isinstance(entry.data, memoryview):
        return
    try:
        yield Decoded(entry.topic, entry.log_ns, entry.data.read())
    except (DecodeError, DataError) as error:
        where = f"{entry.topic} at {entry.publish_ns}: {error}"
        container.once("DEC001", (entry.part, entry.block, entry.offset), where)


def _with_rigs(rigs: Sequence[RigAt], items: Iterable[Copied | Decoded]) -> Iterator[Item]:
    """Put each rig before the messages that it holds for."""
    waiting = list(rigs)
    for item in items:
        while waiting and waiting[0].log_ns <= log_ns_of(item):
            yield waiting.pop(0)
        yield item
    yield from waiting
