"""Frames a second one after the other, and with `--overlap`, back to back on one log.

    python benchmarks/bench_overlap.py [LOG] [--pipelines NAME,NAME] [--overlap N,N] [--repeat N]

Prints a table in Markdown: frames a second and real-time factor (medians of the repeats), and the ratio to one frame
after the other, the median of ratios of replays that followed each other. Also checks that the results are the same
bytes. Without a log, an urban drive of a development seed is simulated, 10 s. Starting processes isn't counted.
"""

import argparse
import tempfile
from pathlib import Path
from statistics import median

from common import write_drive

from fbench.api.replays import replay
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

SAME = ("tracks.parquet", "detections.parquet", "frames.parquet", "faults.json", "scores.json", "manifest.json")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?")
    parser.add_argument("--pipelines", default="late3d")
    parser.add_argument("--overlap", default="1,2")
    parser.add_argument("--repeat", type=int, default=3)
    args = parser.parse_args()
    processes = [int(num) for num in args.overlap.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        log = args.log or write_drive(Path(folder) / "urban.mcap", "urban", 10.0, 101)
        print("| pipeline | processes | frames/s | real-time factor | ratio |\n|---|---:|---:|---:|---:|")
        for pipeline in args.pipelines.split(","):
            hosts: dict[int, list[dict[str, float]]] = {num: [] for num in processes}
            results = set()
            for _ in range(args.repeat):
                for num in processes:
                    out = Path(folder) / "run"
                    source = LogRequest(log)
                    request = ReplayRequest(source, pipeline, out=out, overwrite=True, overlap=num, no_media=True)
                    run = replay(request).run
                    hosts[num].append(run.json("host.json"))
                    results.add(tuple((out / name).read_bytes() for name in SAME))
            assert len(results) == 1, "the results differ"
            for num in processes:
                pairs = zip(hosts[num], hosts[processes[0]], strict=True)
                ratio = median(own["frames_per_s"] / first["frames_per_s"] for own, first in pairs)
                fps, factor = (median(host[key] for host in hosts[num]) for key in ("frames_per_s", "achieved_rate"))
                print(f"| {pipeline} | {num} | {fps:.1f} | {factor:.2f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
