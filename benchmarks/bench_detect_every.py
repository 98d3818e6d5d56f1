"""F1, MOTA and milliseconds where detection runs in every frame, or in one of 2, 3 or 5.

    python benchmarks/bench_detect_every.py [LOG ...] [--pipelines NAME,NAME] [--every N,N] [--set NAME=VALUE ...]

Prints a table in Markdown. Without logs, drives of development seeds in clear weather are simulated: 3 s each, urban
and highway. F1 is taken on all frames: in those between, the predicted tracks stand for detections. Milliseconds are
means over frames, since the median frame is one in which nothing is detected; the first frame of a log doesn't count.
"""

import argparse
import tempfile
from pathlib import Path

from common import write_drive

from fbench.api.replays import replay
from fbench.metrics.latency import count_frames, warm_up_frames
from fbench.metrics.runs.combine import combine_runs, measure_run
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

PIPELINES = "camera2d,lidar3d,radar3d,late3d"
SEEDS = (101, 102)
METRICS = ("f1", "mota", "mota_no_fp")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="*")
    parser.add_argument("--pipelines", default=PIPELINES)
    parser.add_argument("--every", default="1,2,3,5")
    parser.add_argument("--set", dest="settings", action="append", default=[])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        logs = args.logs or [
            write_drive(Path(folder) / f"{world}-{seed}.mcap", world, 3.0, seed)
            for world in ("urban", "highway")
            for seed in SEEDS
        ]
        print(
            "| pipeline | detection in one frame of | predicted detections % | F1 % | MOTA % | MOTA % (thesis) | ms |"
        )
        print("|---|---:|---:|---:|---:|---:|---:|")
        for pipeline in args.pipelines.split(","):
            for every in map(int, args.every.split(",")):
                settings, runs = [*args.settings, f"detect_every={every}"], []
                for log in logs:
                    out = Path(folder) / "runs" / log.stem
                    request = ReplayRequest(LogRequest(log), pipeline, settings, out=out, overwrite=True, no_media=True)
                    runs.append(replay(request).run)
                rows = combine_runs(measure_run(run, ScoreOptions()) for run in runs)
                counts = next(row.counts for row in rows if row.metric == "f1")
                share = counts.get("predicted", 0) / max(1, counts["tp"] + counts["fp"])
                # The first row of a metric is about all vehicles, in the pipeline's own space.
                values = [next((row.value for row in rows if row.metric == m), None) for m in METRICS]
                numbers = ["–" if value is None else f"{100 * value:.2f}" for value in values]
                warm = [count_frames(r.frame_times, warm_up_frames(r.frame_times, r.compiled_frames)) for r in runs]
                times = [ns for own in warm for ns in own["total"]]
                cells = (pipeline, every, f"{100 * share:.0f}", *numbers, f"{sum(times) / len(times) / 1e6:.1f}")
                print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
