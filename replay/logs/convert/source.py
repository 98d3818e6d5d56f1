"""The log that is converted, and what of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from fbench.replay.data import LogInfo
from fbench.replay.excerpt import Excerpt
from fbench.replay.logs.container import Container
from fbench.replay.logs.convert.choose import chosen, left_out
from fbench.replay.logs.convert.cut import Window, window_of
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.reader import LogReader


@dataclass(frozen=True)
class Source:
    """A log, opened, with the topics and the time that are wanted of it."""

    container: Container
    topics: Sequence[str] = ()
    """Patterns."""
    excerpt: Excerpt = field(default_factory=Excerpt)
    """A range of time, by `log_ns`."""

    @cached_property
    def reader(self) -> LogReader:
        """The whole log."""
        return LogReader(self.container)

    @cached_property
    def channels(self) -> frozenset[int]:
        """Channels that are wanted."""
        return chosen(self.container, self.reader.roles, self.topics)

    @cached_property
    def gone(self) -> frozenset[str]:
        """Sensors that aren't wanted."""
        return left_out(self.reader.roles, self.channels)

    @cached_property
    def window(self) -> Window:
        """Time that is wanted."""
        return window_of(self.excerpt, self.container, self.reader.roles)

    @property
    def info(self) -> LogInfo:
        """Id, given or derived, and metadata."""
        return self.reader.info

    @cached_property
    def about(self) -> LogHeader:
        """What the new log says about itself, where messages tell the rig."""
        kinds = {} if self.container.header is None else self.container.header.kinds
        wanted = {name: kind for name, kind in kinds.items() if name not in self.gone}
        return LogHeader(self.info.log_id, self.info.metadata, wanted)
