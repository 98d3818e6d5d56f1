"""Write a long log: the messages and truth of a short one, again and again, with stamps that go on.

    fbench log simulate urban --seconds 8 -o short.mcap
    python benchmarks/make_long_log.py short.mcap long.mcap --seconds 3600

Stamps, arrivals and frame numbers go on as if the drive had no end; poses and truth begin anew with each repetition.
Memory holds the short log once, whatever the length of the long one.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from heapq import merge
from pathlib import Path

import numpy as np

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import RigChange
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log
from fbench.replay.logs.reader import LogReader

Item = Message | Truth


def read_items(reader: LogReader) -> list[Item]:
    """Return measurements, poses and truth in the order of their arrival."""
    messages = (item for item in reader.messages() if not isinstance(item, RigChange))
    truths = sorted(reader.truths(), key=lambda truth: truth.log_ns)
    return list(merge(messages, truths, key=lambda item: item.log_ns))


def find_period_ns(items: list[Item]) -> int:
    """Return how long the log lasts by the stream that makes it longest: its messages times their median step."""
    streams: dict[str, list[int]] = {}
    for item in items:
        streams.setdefault("truth" if isinstance(item, Truth) else item.sensor, []).append(item.stamp_ns)
    return max(len(stamps) * round(float(np.median(np.diff(stamps)))) for stamps in streams.values() if len(stamps) > 1)


def repeat(items: list[Item], period_ns: int, seconds: float) -> Iterator[Item]:
    """Yield the items until so much log time is over; what overlaps with the next repetition is put in order."""
    end_ns, num_frames = items[0].log_ns + round(seconds * 1e9), 1 + max(item.frame_number or 0 for item in items)
    overlap: list[Item] = []
    for turn in range(-(-round(seconds * 1e9) // period_ns)):
        by_ns, by_frames = turn * period_ns, turn * num_frames
        shifted = [
            replace(
                item, stamp_ns=item.stamp_ns + by_ns, log_ns=item.log_ns + by_ns,
                frame_number=None if item.frame_number is None else item.frame_number + by_frames,
            )
            for item in items
        ]  # fmt: skip
        next_ns = shifted[0].log_ns + period_ns
        together = list(merge(overlap, shifted, key=lambda item: item.log_ns))
        overlap = [item for item in together if item.log_ns >= next_ns]
        yield from (item for item in together if item.log_ns < min(next_ns, end_ns))


def main() -> None:
    """Write the log, and print its size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("short", type=Path)
    parser.add_argument("long", type=Path)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--gigabytes", type=float, help="in place of --seconds: about as large")
    args = parser.parse_args()
    reader, start = open_log(args.short, FaultLog()), time.perf_counter()
    items = read_items(reader)
    period_ns, num_written, seconds = find_period_ns(items), 0, args.seconds
    if args.gigabytes is not None:
        seconds = args.gigabytes * 1e9 / args.short.stat().st_size * period_ns / 1e9
    info = replace(reader.info, log_id=f"{reader.info.log_id}-long-{seconds:g}")
    with McapWriter(args.long, info, reader.rig) as log:
        for item in repeat(items, period_ns, seconds):
            log.write(item)
            num_written += 1
    size, taken = args.long.stat().st_size / 1e9, time.perf_counter() - start
    sys.stdout.write(f"{args.long}: {num_written} messages, {size:.2f} GB, written in {taken:.0f} s\n")


if __name__ == "__main__":
    main()
