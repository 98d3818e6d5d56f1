"""F1 on stretches of Astyx HiRes 2019 that are left out in turn while parameters are chosen on the others.

    python benchmarks/bench_leave_out.py FOLDER [FOLDER ...] --weights FILE.onnx [--pipelines NAME,NAME]

Each run of consecutive frames in the folders is a stretch, and becomes a log of its own. For pipelines with
`CANDIDATES`, each stretch is scored with those settings that are best on all others. Prints tables in Markdown: F1 over
all stretches with 95% intervals (2,000 resamples of the stretches), and by how much each fusion is ahead of the best of
its inputs.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fbench.api.runs import replay
from fbench.replay.data.arrays import Float64
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

INPUTS = {
    "camera2d": (), "lidar2d": (), "radar2d": (), "early2d": ("camera2d", "lidar2d", "radar2d"),
    "late2d": ("camera2d", "lidar2d", "radar2d"), "lidar3d": (), "radar3d": (), "early3d": ("lidar3d", "radar3d"),
    "late3d": ("lidar3d", "radar3d"),
}  # fmt: skip
"""Pipelines, and for fusions those that use one of their sensors in the same dimension."""
_ASSOCIATION = "fusion.association."
_OLD = (
    f"{_ASSOCIATION}tilt_std_rad=0.004", f"{_ASSOCIATION}lidar_area_m2=100", "fusion.lidar_half_m=40",
    "fusion.agreement.radar=0.4",
)  # fmt: skip
CANDIDATES: Mapping[str, Sequence[tuple[str, ...]]] = {
    "late3d": ((), _OLD, *((*_OLD[:at], *_OLD[at + 1 :]) for at in range(len(_OLD)))),
    "early2d": ((), ("fusion.measured_share=0",), ("fusion.measured_share=0.2",)),
    "late2d": ((), ("fusion.measured_share=0",), ("fusion.measured_share=0.2",)),
}
"""Settings to choose from: the defaults, those of earlier versions, and what lies between."""
RESAMPLES = 2000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--pipelines", default=",".join(INPUTS))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        logs = write_stretches(args.folders, Path(temporary))
        counts = {
            name: leave_one_out([
                [count(log, name, settings, args.weights) for log in logs] for settings in CANDIDATES.get(name, ((),))
            ])
            for name in args.pipelines.split(",")
        }  # fmt: skip
    print(f"{len(logs)} stretches\n\n| pipeline | F1 % | 95% interval | TP | FP | FN | ahead of the best input |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    rows = np.random.Generator(np.random.Philox(0)).integers(0, len(logs), (RESAMPLES, len(logs)))
    for name, own in counts.items():
        sums, values = own.sum(axis=0), 100 * f1(own[rows].sum(axis=1))
        low, high = np.percentile(values, [2.5, 97.5])
        inputs = [counts[other] for other in INPUTS[name] if other in counts]
        ahead = ""
        if inputs:
            best = max(inputs, key=lambda one: float(f1(one.sum(axis=0))))
            difference = values - 100 * f1(best[rows].sum(axis=1))
            least, most = np.percentile(difference, [2.5, 97.5])
            ahead = f"{100 * float(f1(sums) - f1(best.sum(axis=0))):+.1f} ({least:+.1f} to {most:+.1f})"
        print(f"| `{name}` | {100 * f1(sums):.1f} | {low:.1f} to {high:.1f} | {' | '.join(map(str, sums))} | {ahead} |")


def write_stretches(folders: Sequence[Path], out: Path) -> list[Path]:
    """Import each run of consecutive frames as a log."""
    logs = []
    for folder in folders:
        frames = sorted(int(path.stem) for path in (folder / "camera_front").iterdir())
        begins = [frame for frame in frames if frame - 1 not in frames]
        ends = [frame + 1 for frame in frames if frame + 1 not in frames]
        for begin, end in zip(begins, ends, strict=True):
            logs.append(out / f"frames-{begin}.mcap")
            command = ["log", "import", "astyx", str(folder), "-o", str(logs[-1]), "--frames", f"{begin}:{end}"]
            subprocess.run(
                [sys.executable, "-c", "from fbench.cli import main; main()", *command], check=True, capture_output=True
            )
    return logs


def count(log: Path, pipeline: str, settings: Sequence[str], weights: Path) -> Float64:
    """True positives, false ones, and misses (3,) of a log, by the primary F1."""
    uses_camera = not pipeline.startswith(("lidar", "radar"))
    settings = [*settings, *([f"camera.weights={weights}"] if uses_camera else [])]
    with tempfile.TemporaryDirectory() as folder:
        run = replay(ReplayRequest(LogRequest(log), pipeline, settings, out=Path(folder) / "run"))
        scores = run.scores()
    counts = scores[(scores["metric"] == "f1") & (scores["slice"] == "all")].iloc[0]["counts"]
    return np.array([counts["tp"], counts["fp"], counts["fn"]])


def leave_one_out(candidates: Sequence[Sequence[Float64]]) -> Float64:
    """Counts (S, 3) of each stretch with the settings that are best on all others; of equal ones the first."""
    table = np.array(candidates)  # (candidates, stretches, counts)
    others = table.sum(axis=1, keepdims=True) - table
    chosen = np.argmax(f1(others), axis=0)
    return np.asarray(table[chosen, np.arange(table.shape[1])])


def f1(counts: Float64) -> Float64:
    """F1 (...) of counts (..., 3)."""
    tp, fp, fn = np.moveaxis(np.asarray(counts, np.float64), -1, 0)
    return np.asarray(2 * tp / np.maximum(2 * tp + fp + fn, 1))


if __name__ == "__main__":
    main()
