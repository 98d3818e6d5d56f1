"""HOTA, CLEAR and Identity of one tracker over KITTI's 21 tracking sequences: ours, TrackEval's and motrics', a Rust
library's, from the same files: in one process, and CPU time of fresh ones that read, count, and write all rows.

Run it from the root of the repository, with the data of `tests` beside it; `PYTHONPATH=FOLDER` adds a folder made by
`pip install --no-deps --target FOLDER trackeval==1.3.0 motrics==0.3.0`, which leaves this environment as it is.

Counts of all three must be equal. motrics sums up nothing over sequences and makes no rows of thresholds.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from common import best_by_turns_s
from other_tracking_metrics import CLASSES, ROOT, TRACKER, Counts, Motrics, make_trackeval

from fbench.metrics.core.problem import Problem
from fbench.metrics.core.similarity import blocks
from fbench.metrics.files.sequences import Choice, open_files
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.trackeval.fields import ClassCounts
from fbench.metrics.profiles.trackeval.prepare import HALF, KITTI, problems
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence


def sequences() -> Iterable[Sequence]:
    """Read truth and results."""
    choice = Choice(seqmap=ROOT / "evaluate_tracking.seqmap.training")
    return open_files(ROOT / "label_02", ROOT / f"trackers_2d/{TRACKER}/data", choice).sequences()


def prepare(held: Iterable[Sequence]) -> list[tuple[Objects, Objects, Problem]]:
    """Leave out what KITTI's rules excuse: truth and results of each class and sequence."""
    found = ((one, problem) for one in held for problem in problems(one, KITTI, HALF))
    return [(one.truth[own.truth_row], one.estimates[own.estimate_row], own) for one, own in found]


def count_prepared(prepared: Iterable[tuple[Objects, Objects, Problem]]) -> list[ClassCounts]:
    """Compare boxes, and count."""
    pairs = ((blocks(truth, own, len(given.stream), HALF.kind), given) for truth, own, given in prepared)
    return [TRACKEVAL_KITTI.count(replace(given, pairs=found)) for found, given in pairs]


def score(given: Iterable[Sequence]) -> list[Score]:
    """All rows, over all sequences and of each."""
    return evaluate(TRACKEVAL_KITTI, given).scores()


def our_counts(rows: Iterable[Score]) -> Counts:
    """Counts over all sequences out of our rows."""
    by_name = {(row.class_, row.metric): int(row.value or 0) for row in rows if row.slice == "all"}
    return {name: tuple(by_name[name, m] for m in ("clr_tp", "clr_fp", "clr_fn", "idsw", "idtp")) for name in CLASSES}


def fresh_s(*command: str) -> float:
    """CPU time of a command in a fresh process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print times and ratios."""
    if not ROOT.is_dir():
        print(f"no data at {ROOT}", file=sys.stderr)
        return
    held = list(sequences())
    prepared, names = prepare(held), ("counting of prepared boxes", "preparation and counting")
    wanted = our_counts(score(held))  # compiles
    parts: dict[str, Callable[[], object]] = {
        "counting of prepared boxes": lambda: count_prepared(prepared),
        "preparation and counting": lambda: [TRACKEVAL_KITTI.measure(one) for one in held],
        "preparation, counting and rows": lambda: score(held),
        "reading, preparation, counting and rows": lambda: score(sequences()),
    }
    pairs, whole = list[tuple[str, str]](), list(parts)[-1]
    found: dict[str, Counts] = {}
    if (theirs := make_trackeval()) is not None:
        found["TrackEval"], parts["TrackEval, all"] = theirs(), theirs
        pairs.append((whole, "TrackEval, all"))
    try:
        own = Motrics()
    except ImportError as error:
        print(f"motrics can't be imported ({error}): see this file's head how to install it", file=sys.stderr)
    else:
        read = own.read()
        theirs_prepared = own.prepare(read)
        found["motrics"] = own.count(theirs_prepared)
        parts["motrics, counting of prepared boxes"] = lambda: own.count(theirs_prepared)
        parts["motrics, preparation and counting"] = lambda: own.count(own.prepare(read))
        parts["motrics, all"] = lambda: own.count(own.prepare(own.read()))
        pairs += [*((name, f"motrics, {name}") for name in names), (whole, "motrics, all")]
    for name, counts in found.items():
        assert counts == wanted, (name, counts, wanted)
        print(f"{name} counts the same: {counts}")
    times = best_by_turns_s(parts, 5, time.process_time)
    for name, time_s in times.items():
        print(f"{name}, {len(held)} sequences, cars and pedestrians: {1e3 * time_s:.0f} ms of CPU")
    for ours, name in pairs:
        print(f"{name} takes {times[name] / times[ours]:.2f} times as long as our {ours}")
    with tempfile.TemporaryDirectory() as folder:
        files = ("--truth", str(ROOT / "label_02"), "--detections", str(ROOT / "trackers_2d" / TRACKER))
        seqmap = ("--seqmap", str(ROOT / "evaluate_tracking.seqmap.training"))
        command = [
            str(Path(sys.executable).parent / "fbench"),
            "score",
            *files,
            "--profile",
            "trackeval-kitti",
            *seqmap,
        ]
        fresh = {"fbench score": command, "fbench score -o": [*command, "-o", os.path.join(folder, "scores.json")]}
        fresh |= {
            name: [sys.executable, str(Path(__file__).with_name("other_tracking_metrics.py")), name] for name in found
        }
        for name, words in fresh.items():
            print(f"{name} in a fresh process: {min(fresh_s(*words) for _ in range(3)):.2f} s of CPU")


if __name__ == "__main__":
    main()
