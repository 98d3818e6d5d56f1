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
from collections.abc import Callable, Iterable
from pathlib import Path

from common import best_by_turns_s
from other_tracking_metrics import CLASSES, ROOT, TRACKER, Counts, Motrics, make_trackeval

from fbench.metrics.files.sequences import Choice, open_files
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence


def sequences() -> Iterable[Sequence]:
    """Read truth and results."""
    choice = Choice(seqmap=ROOT / "evaluate_tracking.seqmap.training")
    return open_files(ROOT / "label_02", ROOT / f"trackers_2d/{TRACKER}/data", choice).sequences()


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
    wanted = our_counts(score(held))  # compiles
    parts: dict[str, Callable[[], object]] = {
        "counting": lambda: [TRACKEVAL_KITTI.measure(one) for one in held],
        "counting and rows": lambda: score(held),
        "reading, counting and rows": lambda: score(sequences()),
    }
    pairs: list[tuple[str, str]] = []
    found: dict[str, Counts] = {}
    if (theirs := make_trackeval()) is not None:
        found["TrackEval"], parts["TrackEval, all"] = theirs(), theirs
        pairs.append(("reading, counting and rows", "TrackEval, all"))
    try:
        own = Motrics()
    except ImportError as error:
        print(f"motrics can't be imported ({error}): see this file's head how to install it", file=sys.stderr)
    else:
        read = own.read()
        prepared = own.prepare(read)
        found["motrics"] = own.count(prepared)
        parts["motrics, counting of prepared boxes"] = lambda: own.count(prepared)
        parts["motrics, preparation and counting"] = lambda: own.count(own.prepare(read))
        parts["motrics, all"] = lambda: own.count(own.prepare(own.read()))
        pairs += [("counting", name) for name in list(parts)[-3:-1]]
        pairs.append(("reading, counting and rows", "motrics, all"))
    for name, counts in found.items():
        assert counts == wanted, (name, counts, wanted)
        print(f"{name} counts the same: {counts}")
    times = best_by_turns_s(parts, 5)
    for name, time_s in times.items():
        print(f"{name}, {len(held)} sequences, cars and pedestrians: {1e3 * time_s:.0f} ms")
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
