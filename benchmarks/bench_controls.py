"""How far control variates narrow the interval of F1 on real recordings, and how often it holds the true value.

    python benchmarks/bench_controls.py ASTYX_FOLDER... --out FOLDER [--trials 1000]

Each run of consecutive frames is imported as a log and replayed with LiDAR and radar. In each trial some frames, drawn
at random, keep their labels. Of the F1 of all frames, which is known here, an interval is estimated from the labels
alone, and with the agreement with other pipelines on all frames. Printed are both coverages and the narrowing.
"""

import argparse
from pathlib import Path

import numpy as np
from bench_leave_out import write_stretches

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.metrics.comparison.control import control
from fbench.metrics.comparison.counts import RATIOS, count_frames, options_of
from fbench.metrics.comparison.reference import count_agreement
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Int64
from fbench.replay.runs.folder import Run
from fbench.replay.setup.source import NO_CONFIG

CONTROLS = {
    "lidar3d": (("radar3d",), ("radar3d", "late3d")),
    "radar3d": (("late3d",), ("early3d",)),
    "early3d": (("radar3d",),),
    "late3d": (("radar3d",), ("radar3d", "lidar3d")),
}
LABELED = (30, 40, 60)
F1 = RATIOS["detection"]["f1"]


def count_labeled(folders: list[Path]) -> Int64:
    """Counts (N, 3) of vehicles of all frames."""
    found = []
    for folder in folders:
        frames = count_frames(Run(folder), options_of(Run(folder).scores))
        found.append(next(own for place, own in frames.counts.items() if place[:3] == ("detection", "vehicle", "all")))
    return np.concatenate(found)


def main() -> None:
    """Replay what isn't there, and print a row for each pipeline, its controls, and number of labels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=1000)
    args = parser.parse_args()
    logs = sorted(args.out.glob("*.mcap")) or write_stretches(args.folders, args.out)
    runs = {name: [args.out / name / log.stem for log in logs] for name in CONTROLS}
    for name, folders in runs.items():
        for log, folder in zip(logs, folders, strict=True):
            if not folder.exists():
                given = LogRequest(log, config=NO_CONFIG)
                replay(ReplayRequest(given, name, sensors=["!camera*"], out=folder, no_media=True))
    print("| pipeline | controls | labeled | coverage, labels alone | with controls | interval | narrower by |")
    print("|---|---|--:|--:|--:|--:|--:|")
    for name, choices in CONTROLS.items():
        counts = count_labeled(runs[name])
        true = float(F1(counts.sum(axis=0, dtype=np.float64)))
        for others in choices:
            agreement = [
                np.concatenate([count_agreement(Run(a), Run(b))[0] for a, b in zip(runs[name], runs[o], strict=True)])
                for o in others
            ]
            for num in LABELED:
                held, width = np.zeros(2), np.zeros(2)
                for trial in range(args.trials):
                    chosen = generator(trial, "labeled").permutation(len(counts))[:num]
                    is_labeled = np.isin(np.arange(len(counts)), chosen)
                    found = control(counts[is_labeled], agreement, is_labeled, F1)
                    for at, one in enumerate((found.plain, found.narrow)):
                        held[at] += one.low <= true <= one.high
                        width[at] += one.width / args.trials
                shares = " | ".join(f"{100 * own / args.trials:.1f} %" for own in held)
                gain = 100 * (1 - width[1] / width[0])
                print(f"| {name} | {', '.join(others)} | {num} | {shares} | ±{50 * width[1]:.1f} % | {gain:.0f} % |")


if __name__ == "__main__":
    main()
