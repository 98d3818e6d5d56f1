"""Messages that can't be used, found again by the frame that they would have been in."""

from bisect import bisect_left, bisect_right, insort
from typing import NamedTuple


class Skipped(NamedTuple):
    """A message that can't be used."""

    sensor: str
    stamp_ns: int
    frame_number: int | None
    reason: str


class SkippedMessages:
    """Keeps them so that finding one takes no longer in a long log.

    Args:
        tolerance_ns: How far a stamp may be from the instant of its frame [ns].
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._by_number: dict[tuple[str, int], Skipped] = {}
        self._by_stamp: dict[str, list[Skipped]] = {}

    def add(self, message: Skipped) -> None:
        """Keep one message."""
        if message.frame_number is not None:
            self._by_number[message.sensor, message.frame_number] = message
        insort(self._by_stamp.setdefault(message.sensor, []), message, key=_stamp_ns)

    def reason(self, sensor: str, stamp_ns: int, frame_number: int | None) -> str | None:
        """Why the sensor's message of this frame was skipped; `None` where there was none: by frame number where both
        have one, else by nearest stamp.
        """
        if frame_number is not None and (found := self._by_number.get((sensor, frame_number))):
            return found.reason
        messages = self._by_stamp.get(sensor, [])
        first = bisect_left(messages, stamp_ns - self._tolerance_ns, key=_stamp_ns)
        stop = bisect_right(messages, stamp_ns + self._tolerance_ns, key=_stamp_ns)
        near = [m for m in messages[first:stop] if frame_number is None or m.frame_number is None]
        return min(near, key=lambda m: abs(m.stamp_ns - stamp_ns)).reason if near else None


def _stamp_ns(message: Skipped) -> int:
    return message.stamp_ns
