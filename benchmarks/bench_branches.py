"""Sensor branches of `late3d` side by side against one after the other, in one process.

    python benchmarks/bench_branches.py [LOG] [--pipeline NAME] [--rounds N]

Both see the same frames, by turns, and must find the same. Without a log, 2 s of a city drive are simulated. Threads
of the camera's detector are varied too, since they compete with the other branches for the same processors.
"""

import argparse
import os
import statistics
import tempfile
import time
from itertools import product
from pathlib import Path

from common import frames_of, threads, write_drive

from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.data.frames import Frame
from fbench.replay.runs.digest import digest

Way = tuple[int, int]  # Threads of branches, and of the detector


def by_turns(ways: dict[Way, Pipeline], frames: list[Frame]) -> dict[Way, list[float]]:
    """Return wall times [ms] of all frames but the first. Each way takes each frame in turn, so that what else the
    machine does hits all alike. Raises AssertionError where they don't find the same.
    """
    times: dict[Way, list[float]] = {way: [] for way in ways}
    for pipeline in ways.values():
        pipeline.reset("again")
    for index, frame in enumerate(frames):
        found = set()
        turn = index % len(ways)
        for way in [*ways][turn:] + [*ways][:turn]:
            start = time.perf_counter()
            output = ways[way].step(frame)
            times[way].append(1e3 * (time.perf_counter() - start))
            found.add(digest([output.detections, output.tracks]))
        assert len(found) == 1, f"frame {index}: branches side by side found something else"
    return {way: taken[1:] for way, taken in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--pipeline", default="late3d")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = args.log or write_drive(Path(folder) / "urban.mcap", "urban", 2.0, 101)
        rig, info, frames = frames_of(log)
    most = max(2, len(os.sched_getaffinity(0)))
    ways = {}
    for branches, detector in product((1, most), (1, 2)):
        with threads(branches):
            ways[branches, detector], _ = make_pipeline(args.pipeline, [])
        with threads(detector):  # which is loaded when the log is known
            ways[branches, detector].start(rig, info)
    by_turns(ways, frames[:5])  # also compiles
    rounds = [by_turns(ways, frames) for _ in range(args.rounds)]
    times = {way: [ms for found in rounds for ms in found[way]] for way in ways}
    base = statistics.median(times[1, 1])
    print(f"{args.pipeline} on {log.stem}, {args.rounds} times {len(frames)} frames, medians a frame, equal output")
    for (branches, detector), taken in times.items():
        how = "one after the other" if branches == 1 else f"side by side on {branches}"
        ms, p99 = statistics.median(taken), statistics.quantiles(taken, n=100)[98]
        times_as_fast = f"{base / ms:.2f} times as fast as on one"
        print(f"  {how}, detector on {detector}: {ms:.1f} ms, p99 {p99:.1f} ms, {times_as_fast}")


if __name__ == "__main__":
    main()
