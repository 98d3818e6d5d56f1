"""HOTA, CLEAR and Identity of one tracker over KITTI's 21 tracking sequences: ours against TrackEval's, in one process.

Run it from the root of the repository, with the data of `tests` beside it; `PYTHONPATH=FOLDER` adds a folder made by
`pip install --no-deps --target FOLDER trackeval==1.3.0`, which leaves this environment as it is.
"""

import contextlib
import io
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from common import best_by_turns_s

from fbench.metrics.files.sequences import Choice, open_files
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

ROOT = Path(__file__).resolve().parents[2] / "shared/data/kitti_tracking"
TRACKER = "GT-SORT"


def sequences() -> Iterable[Sequence]:
    """Read truth and results."""
    choice = Choice(seqmap=ROOT / "evaluate_tracking.seqmap.training")
    return open_files(ROOT / "label_02", ROOT / f"trackers_2d/{TRACKER}/data", choice).sequences()


def score(given: Iterable[Sequence]) -> list[Score]:
    """All rows, over all sequences and of each."""
    return evaluate(TRACKEVAL_KITTI, given).scores()


def reference() -> Callable[[], float] | None:
    """What runs TrackEval and returns its MOTA of cars, where it is installed."""
    try:
        import trackeval  # type: ignore[import-not-found,unused-ignore]
    except ImportError as error:
        print(f"TrackEval can't be imported ({error}): see this file's head how to install it", file=sys.stderr)
        return None
    quiet = {"PRINT_CONFIG": False}
    output = ("PRINT_RESULTS", "OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES", "TIME_PROGRESS")
    folders = {"GT_FOLDER": str(ROOT), "TRACKERS_FOLDER": str(ROOT / "trackers_2d"), "TRACKERS_TO_EVAL": [TRACKER]}

    def run() -> float:
        with contextlib.redirect_stdout(io.StringIO()):
            evaluator = trackeval.Evaluator(dict.fromkeys(output, False) | quiet)
            dataset = trackeval.datasets.Kitti2DBox(folders | quiet)
            metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(quiet), trackeval.metrics.Identity(quiet)]
            found, _ = evaluator.evaluate([dataset], metrics)
        return float(found["Kitti2DBox"][TRACKER]["COMBINED_SEQ"]["car"]["CLEAR"]["MOTA"])

    return run


def main() -> None:
    """Print times and ratios."""
    if not ROOT.is_dir():
        print(f"no data at {ROOT}", file=sys.stderr)
        return
    held = list(sequences())
    rows = score(held)  # compiles
    parts: dict[str, Callable[[], object]] = {
        "counting": lambda: [TRACKEVAL_KITTI.measure(one) for one in held],
        "counting and rows": lambda: score(held),
        "reading, counting and rows": lambda: score(sequences()),
    }
    theirs = reference()
    if theirs is not None:
        mota = next(row.value for row in rows if (row.metric, row.class_, row.slice) == ("mota", "car", "all"))
        assert mota is not None
        assert abs(theirs() - mota) < 1e-9
        parts["TrackEval, all"] = theirs
    times = best_by_turns_s(parts, 5)
    for name, time_s in times.items():
        ratio = f", TrackEval takes {times['TrackEval, all'] / time_s:.1f} times as long" if theirs else ""
        print(f"{name}, {len(held)} sequences, cars and pedestrians: {1e3 * time_s:.0f} ms{ratio}")


if __name__ == "__main__":
    main()
