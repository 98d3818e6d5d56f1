"""False alarms, power and coverage of `fbench compare`, on resampled stretches of two real runs of one log.

    python benchmarks/bench_gate.py RUN RUN [--trials 1000] [--numbers 100] [--units 40]

- A/A: the two runs' results of each resampled stretch are swapped at random, so that there is no difference. Reported
  is in how many comparisons any of the numbers, judged together, is REGRESSED (Holm) or improved.
- Power: hits of the head become misses, as many as make the F1 drop by the smallest difference that the comparison
  states for 90 %. Reported is how often the drop is found among all numbers.
- Coverage: how often the 95 % interval holds the difference of all stretches, from which those of a trial are drawn,
  in five times as many trials: of 1000 alone, chance makes 93.6 % to 96.4 % of 95 %.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.metrics.comparison.counts import FrameCounts, Place, count_frames, metrics_of, options_of
from fbench.metrics.comparison.inference import ErrorRates, PairedUnits, Ratio, adjust_holm
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.runs.folder import Run

Random = np.random.Generator


@dataclass(frozen=True)
class Number:
    """One metric of one slice: counts (U, K) of both runs by stretch."""

    name: str
    base: Int64
    head: Int64
    value: Ratio


def stretch_counts(frames: FrameCounts, seconds: float) -> dict[Place, Int64]:
    """Add up the counts of each stretch of so many seconds."""
    number = ((frames.stamp_ns - frames.stamp_ns[0]) / 1e9 / seconds).astype(np.int64)
    sums = {}
    for place, counts in frames.counts.items():
        sums[place] = np.zeros((int(number.max()) + 1, counts.shape[1]), np.int64)
        np.add.at(sums[place], number, counts)
    return sums


def numbers_of(folders: Sequence[Path], seconds: float, most: int) -> list[Number]:
    """Return the numbers that two runs of one log have in common, those of all vehicles first."""
    one, two = (stretch_counts(count_frames(Run(f), options_of(Run(f).scores)), seconds) for f in folders)
    found = [
        Number("/".join((metric, *place[1:])), one[place], two[place], ratio)
        for place in one if place in two
        for metric, ratio in metrics_of(place).items()
    ]  # fmt: skip
    return found[:most]


def draw(number: Number, rows: Int64, swapped: Int64) -> tuple[Int64, Int64]:
    """Return stretches (U,) of both runs, swapped where asked for."""
    a, b = number.base[rows], number.head[rows]
    flip = swapped[:, None].astype(bool)
    return np.where(flip, b, a), np.where(flip, a, b)


def false_alarms(numbers: Sequence[Number], num_units: int, trials: int, how: ErrorRates) -> int:
    """Return in how many A/A comparisons any number is found to differ."""
    alarms, units = 0, PairedUnits(num_units, how)
    rough = PairedUnits(num_units, ErrorRates(num_flips=200))
    for trial in range(trials):
        random = generator(trial, "a/a")
        rows = random.integers(0, len(numbers[0].base), num_units)
        swapped = random.integers(0, 2, num_units)
        found = [_test(*draw(number, rows, swapped), number.value, rough, units) for number in numbers]
        alarms += min(adjust_holm([p for p in found if p is not None])) < how.alpha
    return alarms


def _test(base: Int64, head: Int64, value: Ratio, rough: PairedUnits, units: PairedUnits) -> float | None:
    """The p value; of numbers that are far from an alarm a rough one."""
    p = rough.test(base, head, value)
    return p if p is None or p > 0.05 else units.test(base, head, value)


def plant(counts: Int64, num: int, random: Random) -> Int64:
    """Turn `num` hits, anywhere, into misses."""
    hits = np.repeat(np.arange(len(counts)), counts[:, 0])
    lost = np.bincount(random.choice(hits, min(num, len(hits)), replace=False), minlength=len(counts))
    changed = counts.copy()
    changed[:, 0] -= lost
    changed[:, 2] += lost
    return changed


def power(number: Number, num_units: int, trials: int, num_judged: int, how: ErrorRates) -> tuple[int, float]:
    """Return in how many trials a drop of the stated size is found, and its mean size."""
    units, found, sizes = PairedUnits(num_units, how), 0, []
    for trial in range(trials):
        random = generator(trial, "planted")
        rows = random.integers(0, len(number.base), num_units)
        base, head = draw(number, rows, random.integers(0, 2, num_units))
        size = units.infer(base, head, number.value).smallest(how, num_judged)
        if size is None:
            continue
        total = head.sum(axis=0, dtype=np.float64)
        before, num = float(number.value(total)), 0
        while before - float(number.value(total + num * np.array([-1.0, 0.0, 1.0]))) < size and num < total[0]:
            num += 1
        p = units.test(base, plant(head, num, random), number.value)
        found += p is not None and p * num_judged < how.alpha
        sizes.append(size)
    return found, float(np.mean(sizes)) if sizes else float("nan")


def coverage(numbers: Sequence[Number], num_units: int, trials: int, how: ErrorRates) -> Float64:
    """Return the share of trials in which the interval of each number holds the true difference."""
    units, held = PairedUnits(num_units, how), np.zeros((len(numbers), 2))
    for trial in range(trials):
        rows = generator(trial, "coverage").integers(0, len(numbers[0].base), num_units)
        for at, number in enumerate(numbers):
            true = float(number.value(number.head.sum(axis=0) * 1.0)) - float(
                number.value(number.base.sum(axis=0) * 1.0)
            )
            found = units.infer(number.base[rows], number.head[rows], number.value)
            if found.low is not None and found.high is not None:
                held[at] += (found.low <= true <= found.high), 1
    return np.asarray(held[:, 0] / held[:, 1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs=2, type=Path)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--numbers", type=int, default=100)
    parser.add_argument("--units", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--without-alarms", action="store_true", help="measure power and coverage only")
    args = parser.parse_args()
    how = ErrorRates(num_flips=4999)  # Less than alpha / 100, and four times as fast
    numbers = numbers_of(args.runs, args.seconds, args.numbers)
    while len(numbers) < args.numbers:  # of a small log: halves of its stretches count as other slices
        part = len(numbers)
        numbers += [
            Number(f"{n.name}, part", n.base // 2, n.head // 2, n.value) for n in numbers[: args.numbers - part]
        ]
    print(f"{len(numbers)} numbers, {len(numbers[0].base)} stretches of {args.seconds:g} s, {args.units} a trial")
    if not args.without_alarms:
        alarms = false_alarms(numbers, args.units, args.trials, how)
        print(f"A/A: any alarm in {alarms} of {args.trials} ({100 * alarms / args.trials:.1f} %)")
    found, size = power(numbers[0], args.units, args.trials, len(numbers), how)
    print(f"power: {found} of {args.trials} planted drops of {size:.4f} ({numbers[0].name})")
    f1, switches = numbers[:3], [n for n in numbers if n.name.startswith("mota/vehicle/all")][:1]
    for number, share in zip(
        [*f1, *switches], coverage([*f1, *switches], args.units, 5 * args.trials, how), strict=True
    ):
        print(f"coverage: {100 * share:.1f} % ({number.name})")


if __name__ == "__main__":
    main()
