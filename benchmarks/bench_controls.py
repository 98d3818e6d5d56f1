"""How far control variates narrow the interval of F1 on real recordings, and how often it holds the true value.

    python benchmarks/bench_controls.py ASTYX_FOLDER... --out FOLDER [--trials 1000]

Each run of consecutive frames is imported as a log and replayed with LiDAR and radar. In each trial some frames, drawn
at random, keep their labels. Of the F1 of all frames, which is known here, an interval is estimated from the labels
alone, and with the agreement with other pipelines on all frames. Printed are both coverages and the narrowing.

Controls that were chosen on the frames that they are reported on would look better than they are. So they are chosen on
every other log, and reported on the rest, both ways; and all other pipelines together need no choice.
"""

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_leave_out import write_stretches

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.metrics.comparison.control import control
from fbench.metrics.comparison.counts import RATIOS, count_frames, options_of
from fbench.metrics.comparison.reference import count_agreement
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.runs.folder import Run
from fbench.replay.setup.source import NO_CONFIG

PIPELINES = ("lidar3d", "radar3d", "early3d", "late3d")
LABELED = (40, 60)
LABELED_IN_HALF = 30
F1 = RATIOS["detection"]["f1"]


def count_labeled(folders: list[Path]) -> Int64:
    """Counts (N, 3) of vehicles of all frames."""
    found = []
    for folder in folders:
        frames = count_frames(Run(folder), options_of(Run(folder).scores))
        found.append(next(own for place, own in frames.counts.items() if place[:3] == ("detection", "vehicle", "all")))
    return np.concatenate(found)


@dataclass(frozen=True)
class Trials:
    """What became of all trials."""

    held: tuple[float, float]  # Share of intervals that hold the true value: of labels alone, and with controls
    width: tuple[float, float]  # Mean width of the intervals

    @property
    def gain(self) -> float:
        """By which share controls narrow the interval."""
        return 1 - self.width[1] / self.width[0]


def try_controls(counts: Int64, agreement: Sequence[Int64], num_labeled: int, num: int) -> Trials:
    """Draw labeled frames again and again."""
    true = float(F1(counts.sum(axis=0, dtype=np.float64)))
    held, width = np.zeros(2), np.zeros(2)
    for trial in range(num):
        chosen = generator(trial, "labeled").permutation(len(counts))[:num_labeled]
        is_labeled = np.isin(np.arange(len(counts)), chosen)
        found = control(counts[is_labeled], agreement, is_labeled, F1)
        if isinstance(found, str):
            raise SystemExit(found)
        for at, one in enumerate((found.plain, found.narrow)):
            held[at] += (one.low <= true <= one.high) / num
            width[at] += one.width / num
    return Trials((held[0], held[1]), (width[0], width[1]))


def main() -> None:
    """Replay what isn't there, and print rows for each pipeline."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=1000)
    args = parser.parse_args()
    logs = sorted(args.out.glob("*.mcap")) or write_stretches(args.folders, args.out)
    runs = {name: [args.out / name / log.stem for log in logs] for name in PIPELINES}
    for name, folders in runs.items():
        for log, folder in zip(logs, folders, strict=True):
            if not folder.exists():
                given = LogRequest(log, config=NO_CONFIG)
                replay(ReplayRequest(given, name, sensors=["!camera*"], out=folder, no_media=True))
    half = np.concatenate([np.full(len(Run(folder).frames), at % 2) for at, folder in enumerate(runs["lidar3d"])])
    print("| pipeline | controls | frames | labeled | coverage, labels alone | with controls | narrower by |")
    print("|---|---|---|--:|--:|--:|--:|")
    for name in PIPELINES:
        counts, names = count_labeled(runs[name]), [other for other in PIPELINES if other != name]
        agreement = {
            other: np.concatenate(
                [count_agreement(Run(a), Run(b))[0] for a, b in zip(runs[name], runs[other], strict=True)]
            )
            for other in names
        }

        def try_on(frames: Bool, chosen: Sequence[str], num_labeled: int, num: int) -> Trials:
            return try_controls(counts[frames], [agreement[o][frames] for o in chosen], num_labeled, num)  # noqa: B023

        def print_row(chosen: Sequence[str], what: str, frames: Bool, num_labeled: int) -> None:
            found = try_on(frames, chosen, num_labeled, args.trials)
            shares = " | ".join(f"{100 * own:.1f}%" for own in found.held)
            print(f"| {name} | {', '.join(chosen)} | {what} | {num_labeled} | {shares} | {100 * found.gain:.0f}% |")  # noqa: B023

        for num_labeled in LABELED:
            print_row(names, f"all {len(counts)}, no choice", np.ones(len(counts), bool), num_labeled)
        choices = [subset for size in (1, 2, 3) for subset in itertools.combinations(names, size)]
        for part in (0, 1):
            gains = [try_on(half != part, subset, LABELED_IN_HALF, args.trials // 10).gain for subset in choices]
            what = f"{(half == part).sum()}, chosen on the other {(half != part).sum()}"
            print_row(choices[int(np.argmax(gains))], what, half == part, LABELED_IN_HALF)


if __name__ == "__main__":
    main()
