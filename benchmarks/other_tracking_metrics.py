"""TrackEval and motrics on KITTI's tracking sequences; as a program, one of them once: `TrackEval` or `motrics`.

Nothing of fbench is imported, so that a fresh process takes as long as a user's own.
"""

import contextlib
import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2] / "shared/data/kitti_tracking"
TRACKER = "GT-SORT"
Counts = dict[str, tuple[int, ...]]
"""Of each class: true positives, false positives, misses, switches, and true positives of Identity."""
CLASSES = ("car", "pedestrian")


def make_trackeval() -> Callable[[], Counts] | None:
    """What runs TrackEval and returns its counts, where it is installed."""
    try:
        import trackeval  # type: ignore[import-not-found,unused-ignore]
    except ImportError as error:
        print(f"TrackEval can't be imported ({error}): see this file's head how to install it", file=sys.stderr)
        return None
    quiet = {"PRINT_CONFIG": False}
    output = ("PRINT_RESULTS", "OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES", "TIME_PROGRESS")
    folders = {"GT_FOLDER": str(ROOT), "TRACKERS_FOLDER": str(ROOT / "trackers_2d"), "TRACKERS_TO_EVAL": [TRACKER]}

    def run() -> Counts:
        with contextlib.redirect_stdout(io.StringIO()):
            evaluator = trackeval.Evaluator(dict.fromkeys(output, False) | quiet)
            dataset = trackeval.datasets.Kitti2DBox(folders | quiet)
            metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(quiet), trackeval.metrics.Identity(quiet)]
            found, _ = evaluator.evaluate([dataset], metrics)
        total = found["Kitti2DBox"][TRACKER]["COMBINED_SEQ"]
        return {
            name: (*(int(total[name]["CLEAR"][field]) for field in ("CLR_TP", "CLR_FP", "CLR_FN", "IDSW")),
                   int(total[name]["Identity"]["IDTP"]))
            for name in CLASSES
        }  # fmt: skip

    return run


class Motrics:
    """motrics by its own functions for KITTI."""

    def __init__(self) -> None:
        import motrics  # type: ignore[import-not-found,unused-ignore]

        self._motrics: Any = motrics

    def read(self) -> list[Any]:
        """Read truth and results."""
        names = [line.split()[0] for line in (ROOT / "evaluate_tracking.seqmap.training").read_text().splitlines()]
        read, results = self._motrics, ROOT / f"trackers_2d/{TRACKER}/data"
        return [(read.load_kitti_gt(ROOT / f"label_02/{n}.txt"), read.load_kitti(results / f"{n}.txt")) for n in names]

    def prepare(self, held: list[Any]) -> list[Any]:
        """Leave out what KITTI's rules excuse."""
        return [
            (name, self._motrics.preprocess_kitti(truth, results, name, ignore_regions=regions))
            for (truth, regions), results in held
            for name in CLASSES
        ]

    def count(self, prepared: list[Any]) -> Counts:
        """Count all three metrics."""
        frames, total = self._motrics.Frames, Counts((name, (0,) * 5) for name in CLASSES)
        for name, (ids, boxes, result_ids, result_boxes) in prepared:
            found = self._motrics.evaluate(frames(ids, boxes), frames(result_ids, result_boxes))
            clear, own = found.clear, found.identity
            numbers = (clear.num_matches, clear.num_false_positives, clear.num_misses, clear.num_switches, own.idtp)
            total[name] = tuple(a + b for a, b in zip(total[name], numbers, strict=True))
        return total


def run_once(name: str) -> None:
    """Do all work of another tool once, as a user's program would."""
    if name == "motrics":
        own = Motrics()
        print(own.count(own.prepare(own.read())))
    elif (run := make_trackeval()) is not None:
        print(run())


if __name__ == "__main__":
    run_once(sys.argv[1])
