"""What timing costs: a pipeline with and without it, by turns in one process, and the price of its calls alone.

    python benchmarks/bench_timing.py [LOG] [--pipeline NAME] [--rounds N]

Prints the ratio of CPU times, which a busy machine blurs, and the share of a frame that its calls take, which it
doesn't. Without a log, a drive of 2 s with LiDAR and radar is simulated.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from common import best_s, frames_of, threads, write_drive

from fbench.replay.contracts.params import StageClock, synchronize_cuda
from fbench.replay.contracts.plugins import open_pipeline
from fbench.replay.runs.timings import TimingsWriter

NUM_CALLS = 2000


@contextmanager
def untimed(clock: StageClock, name: str) -> Iterator[None]:
    yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--pipeline", default="late3d")
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threads(1):
        log = args.log or write_drive(Path(folder) / "drive.mcap", "urban", 2.0, 101, ("lidar", "radar"))
        rig, info, frames = frames_of(log)
        with open_pipeline(args.pipeline, []) as (pipeline, _):
            timed_stage, num_stages = StageClock.stage, 0

            def play() -> None:
                nonlocal num_stages
                pipeline.start(rig, info)
                num_stages = max(len(pipeline.step(frame).stage_ns) for frame in frames)

            def play_untimed() -> None:
                StageClock.stage = untimed  # type: ignore[method-assign, assignment]
                try:
                    pipeline.start(rig, info)
                    for frame in frames:
                        pipeline.step(frame)
                finally:
                    StageClock.stage = timed_stage  # type: ignore[method-assign]

            play()  # compiles

            def cpu_of(function: Callable[[], object]) -> float:
                return best_s(function, 1, time.process_time)

            pairs = [(cpu_of(play), cpu_of(play_untimed)) for _ in range(args.rounds)]
            with_s, without_s = (min(side) for side in zip(*pairs, strict=True))
            stages = {f"stage{i}": 1 for i in range(num_stages + 1)}

            def time_frames() -> None:
                """Do for many frames what timing does for one: the stages, the whole frame, and a row each."""
                writer = TimingsWriter()
                for index in range(NUM_CALLS):
                    clock = StageClock()
                    time.perf_counter_ns(), time.process_time_ns()
                    for name in stages:
                        with clock.stage(name):
                            pass
                    synchronize_cuda()
                    time.perf_counter_ns(), time.process_time_ns()
                    writer.add(index, clock.stage_ns, cpu_ns=clock.cpu_ns)
                    writer.add(index, {"wait": 1, "output": 1}, outside=True)

            calls_s = best_s(time_frames, args.rounds, time.process_time) / NUM_CALLS
            frame_s = without_s / len(frames)
            print(f"{args.pipeline}: {len(frames)} frames, {num_stages} stages, {1e3 * frame_s:.2f} ms a frame")
            print(f"CPU time with / without timing: {with_s / without_s:.4f} (best of {args.rounds} each, by turns)")
            print(f"calls of timing: {1e6 * calls_s:.1f} us a frame, {100 * calls_s / frame_s:.3f} % of it")


if __name__ == "__main__":
    main()
