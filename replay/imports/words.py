"""Counts and lists as summaries of imports tell them."""

from collections import Counter
from collections.abc import Iterable


def listed(things: Iterable[object], most: int) -> str:
    """Return things with commas between, the first ones of many: `1, 2 and 3 more`."""
    texts = [str(thing) for thing in things]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def runs(numbers: Iterable[int]) -> list[range]:
    """Return the runs of numbers, which ascend."""
    found: list[range] = []
    for number in numbers:
        if found and number == found[-1].stop:
            found[-1] = range(found[-1].start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


def listed_runs(found: Iterable[range], most: int) -> str:
    """Return runs by their first and last numbers: `3, 177 to 180 and 2 more`."""
    return listed((f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in found), most)


def counted(counts: Counter[str]) -> str:
    """Return counts by name, the largest first, equal ones by name: `Car 3, Van 1`."""
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {num}" for name, num in ranked)
