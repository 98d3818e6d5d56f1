"""F1 and MOTA of a suite's pipelines by weather, and how far they are ahead of one another, with intervals over drives.

    fbench bench benchmarks/learned3d.toml -o runs/learned --jobs 2
    python benchmarks/bench_learned.py runs/learned --base lidar3d,late3d [--resamples 3000]
    python benchmarks/bench_learned.py runs/learned --base late2d --slice "range 30-50 m"

The suite's logs are named WORLD-WEATHER-SEED, as the city names them; world and seed are the drive, of which every
weather is a log. Prints tables in Markdown, in 3D where a pipeline's boxes are scored there, else in the image. With
`--slice`, F1 and recall of such a part of the boxes: a range or a visibility, as `scores.json` names it. Visibilities
have recall only, since what isn't there has none.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TypeAlias

import pandas as pd

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.robustness.scenes import ScoredRun, difference, pool, spaces_of
from fbench.replay.data.scores import Figure
from fbench.replay.runs.folder import Run

Runs: TypeAlias = Mapping[tuple[str, str], Sequence[ScoredRun]]
"""By pipeline and weather."""
ALL = "all"


def read_runs(folder: Path) -> dict[tuple[str, str], list[ScoredRun]]:
    """Read the runs of a suite, each also as one of all weathers."""
    found = dict[tuple[str, str], list[ScoredRun]]()
    for cell in pd.read_parquet(folder / "cells.parquet").itertuples():
        if cell.state != "replayed":
            continue
        world, weather, seed = str(cell.log).split("-", 1)[0], *str(cell.log).split("-", 1)[1].rsplit("-", 1)
        weather = weather if cell.condition == "clear" else f"{weather}, {cell.condition}"
        run = ScoredRun(str(cell.pipeline), weather, f"{world}-{seed}", Run(folder / str(cell.run)).scores)
        for name in (weather, ALL):
            found.setdefault((run.configuration, name), []).append(run)
    return found


def cut(runs: Runs, name: str) -> Runs:
    """Return the runs with the scores of one slice, as those of all boxes."""

    def of(run: ScoredRun) -> ScoredRun:
        return replace(run, scores=[replace(score, slice=ALL) for score in run.scores if score.slice == name])

    return {key: [of(run) for run in own] for key, own in runs.items()}


def show(figure: Figure, sign: str = "") -> str:
    """A figure in % with the ends of its interval."""
    if figure.value is None:
        return "–"
    value, *ends = (
        "" if number is None else format(100 * number, f"{sign}.1f")
        for number in (figure.value, figure.low, figure.high)
    )
    return f"{value} ({' to '.join(ends)})" if all(ends) else value


def print_table(title: str, weathers: Sequence[str], rows: Mapping[str, Sequence[str]]) -> None:
    print(f"\n| {title} | {' | '.join(weathers)} |\n|---|{'---:|' * len(weathers)}")
    for name, cells in rows.items():
        print(f"| `{name}` | {' | '.join(cells)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--base", required=True, help="pipelines to which the others are compared")
    parser.add_argument("--resamples", type=int, default=3000)
    parser.add_argument("--slice", default=ALL, help="score a part of the boxes alone, such as 'range 30-50 m'")
    asked = parser.parse_args()
    runs, how = read_runs(asked.folder), Bootstrap(num=asked.resamples)
    names = list(dict.fromkeys(name for name, _ in runs))
    if unknown := set(asked.base.split(",")) - set(names):
        parser.error(f"--base: no {', '.join(sorted(unknown))} in the suite, there are {', '.join(names)}")
    weathers = [*(weather for weather in dict.fromkeys(own for _, own in runs) if weather != ALL), ALL]
    spaces = {name: spaces_of(runs[name, ALL])[-1] for name in names}
    drives = {run.scene for own in runs.values() for run in own}
    print(f"{len(drives)} drives; in brackets 95% of {how.num} resamples of them")
    scored, metrics = cut(runs, asked.slice), ("f1", "mota" if asked.slice == ALL else "recall")
    if not any(run.scores for own in scored.values() for run in own):
        parser.error(f"--slice: no scores of '{asked.slice}'")
    for metric in metrics:
        rows = {
            name: [show(pool(scored.get((name, w), ()), metric, spaces[name], how)) for w in weathers] for name in names
        }
        print_table(f"{metric.upper()}, %", weathers, rows)
    for base, metric in product(asked.base.split(","), metrics):
        others = [name for name in names if name != base and spaces[name] == spaces.get(base)]
        rows = {name: [] for name in others}
        for name, weather in product(others, weathers):
            head, its_runs = (scored.get((own, weather), ()) for own in (name, base))
            rows[name].append(show(difference(head, its_runs, spaces[name], how, metric), "+"))
        print_table(f"{metric.upper()} over {base}", weathers, rows)


if __name__ == "__main__":
    main()
