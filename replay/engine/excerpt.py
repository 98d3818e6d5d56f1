"""Choice of the frames that are replayed: a range of indices, a range of time, or both."""

import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from fbench.replay.contracts.errors import ConfigError

_MAX_S = 9_000_000_000


@dataclass(frozen=True)
class Moment:
    """A point in time."""

    ns: int
    since_start: bool  # Counted from the log's first measurement on, else absolute

    def __str__(self) -> str:
        return f"+{self.ns}ns" if self.since_start else f"{self.ns}ns"

    def absolute_ns(self, start_ns: int) -> int:
        """As a stamp, in a log whose first measurement is at `start_ns`."""
        return self.ns + start_ns if self.since_start else self.ns


@dataclass(frozen=True)
class Excerpt:
    """Half-open ranges of frames; a frame is chosen where it is in both."""

    first: int = 0  # Index of the first frame
    stop: int | None = None  # Index behind the last frame
    start: Moment | None = None  # No frame whose instant is earlier
    end: Moment | None = None  # No frame whose instant isn't earlier

    @property
    def is_whole(self) -> bool:
        """Whether all frames are chosen."""
        return self == Excerpt()

    def has(self, index: int, stamp_ns: int, start_ns: int) -> bool:
        """Tell whether a frame is chosen, in a log whose first measurement is at `start_ns`."""
        early = self.start is not None and stamp_ns < self.start.absolute_ns(start_ns)
        return index >= self.first and not early and not self.is_past(index, stamp_ns, start_ns)

    def is_past(self, index: int, stamp_ns: int, start_ns: int) -> bool:
        """Tell whether a frame is behind the range."""
        late = self.end is not None and stamp_ns >= self.end.absolute_ns(start_ns)
        return late or (self.stop is not None and index >= self.stop)

    def __str__(self) -> str:
        texts = [f"from {self.start}"] if self.start else []
        texts += [f"to {self.end}"] if self.end else []
        last = "" if self.stop is None else self.stop
        texts += [f"frames {self.first}:{last}"] if self.first or self.stop else []
        return " ".join(texts) or "all"


def make_excerpt(from_: str | None, to: str | None, frames: str | None) -> Excerpt:
    """Read `--from`, `--to` and `--frames`. Raises ConfigError where one can't be understood, or a range is empty."""
    first, stop = 0, None
    if frames is not None:
        single, ranged = re.fullmatch(r"[0-9]{1,12}", frames), re.fullmatch(r"([0-9]{0,12}):([0-9]{0,12})", frames)
        if not single and (ranged is None or frames == ":"):
            raise ConfigError(f"--frames {frames}: expected A:B, A:, :B or one index, such as 30:40")
        low, high = (frames, str(int(frames) + 1)) if ranged is None else ranged.groups()
        first, stop = int(low or 0), int(high) if high else None
        if stop is not None and stop <= first:
            raise ConfigError(f"--frames {frames}: the range is empty")
    start = None if from_ is None else _moment("--from", from_)
    end = None if to is None else _moment("--to", to)
    if start and end and start.since_start == end.since_start and start.ns >= end.ns:
        raise ConfigError(f"--from {from_} --to {to}: the range is empty")
    return Excerpt(first, stop, start, end)


def _moment(option: str, text: str) -> Moment:
    if re.fullmatch(r"[0-9]{1,19}ns", text):
        return Moment(int(text[:-2]), since_start=False)
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        seconds = Decimal(-1)
    if not (seconds.is_finite() and 0 <= seconds <= _MAX_S):
        raise ConfigError(f"{option} {text}: expected seconds from the start on, such as 12.5, or a stamp such as 5ns")
    return Moment(round(seconds * 1_000_000_000), since_start=True)
