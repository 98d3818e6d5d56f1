"""Bursts: radars and LiDARs that send one measurement as several messages with one stamp."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from itertools import islice, pairwise
from typing import Any, TypeAlias

import numpy as np

from fbench.replay.data.messages import Message, PointCloud, RadarScan
from fbench.replay.data.rig import RigChange

Scan: TypeAlias = PointCloud | RadarScan
Event: TypeAlias = Message | RigChange

MAX_BURST_NS = 40_000_000  # A measurement arrives within this [ns]: a clock that stands still sends no bursts
NUM_PROBED = 3  # Messages, two of which belong together in a log with bursts
NUM_SAMPLED = 64  # Messages that tell how many make a measurement


def mean_parts(messages: Iterable[Message | None]) -> float:
    """Return how many messages of one sensor, given from its first one on, make a measurement on average: 1 unless two
    of the first three belong together.
    """
    rest = iter(messages)
    sample = [message for message in islice(rest, NUM_PROBED) if message is not None]
    if not any(is_one_scan(a, b) for a, b in pairwise(sample)):
        return 1.0
    sample += [message for message in islice(rest, NUM_SAMPLED - NUM_PROBED) if message is not None]
    return len(sample) / (1 + sum(not is_one_scan(a, b) for a, b in pairwise(sample)))


def is_one_scan(first: Message, later: Message) -> bool:
    """Tell whether two messages of a sensor are parts of one measurement; exact duplicates aren't."""
    if not (isinstance(first, Scan) and isinstance(later, Scan)) or first.frame_number != later.frame_number:
        return False
    is_again = is_repeat(first.stamp_ns, later.stamp_ns, later.log_ns - first.log_ns)
    return is_again and not np.array_equal(first.xyz, later.xyz)


def is_repeat(first_stamp_ns: int, later_stamp_ns: int, pause_ns: int) -> bool:
    """Tell whether a message has the stamp of one that came `pause_ns` before it, as far as it has one."""
    return first_stamp_ns == later_stamp_ns != 0 and 0 <= pause_ns <= MAX_BURST_NS


def join_bursts(events: Iterable[Event], sensors: frozenset[str]) -> Iterator[Event]:
    """Join the parts of each measurement of these sensors: it comes where its last part did, with the `log_ns` of that.
    Later events wait until then, for `MAX_BURST_NS` of log time at most.
    """
    queue: deque[Event | list[Scan]] = deque()
    bursts: dict[str, list[Scan]] = {}  # Those that may go on, by sensor; each is in the queue, too
    for event in events if sensors else ():
        bursts = {name: parts for name, parts in bursts.items() if event.log_ns - parts[0].log_ns <= MAX_BURST_NS}
        if isinstance(event, Scan) and event.sensor in sensors:
            parts = bursts.get(event.sensor, [])
            if any(np.array_equal(part.xyz, event.xyz) for part in parts):
                queue.append(event)
            else:
                is_next = bool(parts) and is_one_scan(parts[0], event)
                burst = [*parts, event] if is_next else [event]
                bursts[event.sensor] = burst
                if is_next:
                    parts.clear()  # nothing is left in its old place
                queue.append(burst)
        else:
            queue.append(event)
        while queue and not any(queue[0] is parts for parts in bursts.values()):
            yield from _events(queue.popleft())
    for item in queue:
        yield from _events(item)
    yield from () if sensors else events


def _events(item: Event | list[Scan]) -> Sequence[Event]:
    if not isinstance(item, list):
        return (item,)
    if len(item) < 2:
        return item
    joined: dict[str, Any] = {"log_ns": item[-1].log_ns}
    for name in (field.name for field in fields(item[0]) if isinstance(getattr(item[0], field.name), np.ndarray)):
        parts = [getattr(part, name) for part in item]
        joined[name] = None if any(part is None for part in parts) else np.concatenate(parts)
    return (replace(item[0], **joined),)
