"""Write `trackeval.json`: what TrackEval 1.3.0 says of `made_tracks.py`.

In an environment of its own (it pulls in another OpenCV):

    python -m venv te && te/bin/pip install trackeval==1.3.0
    te/bin/python -m tests.metrics.tracking.oracles.make_trackeval

Made with numpy 2.4.6 and scipy 1.17.1. Floats are rounded to 12 digits.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trackeval  # type: ignore[import-not-found]
from tests.metrics.tracking.oracles.made_tracks import KITTI_NAMES, MOT_NAMES, NUM_FRAMES, kitti_texts, mot_texts

QUIET = {"PRINT_CONFIG": False}
OUTPUT = {
    "PRINT_RESULTS": False, "TIME_PROGRESS": False, "OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False,
    "PLOT_CURVES": False, "DISPLAY_LESS_PROGRESS": True, **QUIET,
}  # fmt: skip


def evaluated(dataset) -> dict[str, Any]:
    """Fields by sequence, class and metric."""
    metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(QUIET), trackeval.metrics.Identity(QUIET)]
    results, _ = trackeval.Evaluator(OUTPUT).evaluate([dataset], metrics)
    found = results[dataset.get_name()]["made"]
    for row in found.values():
        for of_class in row.values():
            of_class["Count"].pop("Frames", None)
    combined = found["COMBINED_SEQ"]
    for metric in metrics:  # which TrackEval does for other benchmarks only; classes without boxes are left out
        name = metric.get_name()
        classes = {c: combined[c][name] for c in sorted(combined) if not c.startswith("cls_comb")}
        if len(classes) == 1:
            continue
        averaged = metric.combine_classes_class_averaged(classes, ignore_empty_classes=True)
        combined.setdefault("cls_comb_cls_av", {})[name] = averaged
        combined.setdefault("cls_comb_det_av", {})[name] = metric.combine_classes_det_averaged(classes)
    return found


def kitti(root: Path) -> dict[str, Any]:
    """KITTI, cars and pedestrians."""
    (root / "label_02").mkdir()
    (root / "made" / "data").mkdir(parents=True)
    for name in KITTI_NAMES:
        truth, results = kitti_texts(name)
        (root / "label_02" / f"{name}.txt").write_text(truth)
        (root / "made" / "data" / f"{name}.txt").write_text(results)
    rows = [f"{name} empty 000000 {NUM_FRAMES:06d}\n" for name in KITTI_NAMES]
    (root / "evaluate_tracking.seqmap.training").write_text("".join(rows))
    folders = {"GT_FOLDER": str(root), "TRACKERS_FOLDER": str(root), "TRACKERS_TO_EVAL": ["made"]}
    return evaluated(trackeval.datasets.Kitti2DBox({**folders, **QUIET}))


def mot(root: Path, benchmark: str) -> dict[str, Any]:
    """MOTChallenge, pedestrians."""
    (root / "made" / "data").mkdir(parents=True)
    for name in MOT_NAMES:
        truth, results = mot_texts(name)
        (root / name / "gt").mkdir(parents=True)
        (root / name / "gt" / "gt.txt").write_text(truth)
        (root / "made" / "data" / f"{name}.txt").write_text(results)
    folders = {"GT_FOLDER": str(root), "TRACKERS_FOLDER": str(root), "TRACKERS_TO_EVAL": ["made"]}
    sequences = {"SEQ_INFO": dict.fromkeys(MOT_NAMES, NUM_FRAMES), "SKIP_SPLIT_FOL": True, "BENCHMARK": benchmark}
    return evaluated(trackeval.datasets.MotChallenge2DBox({**folders, **sequences, **QUIET}))


def plain(value):
    """JSON of dicts, arrays and numbers."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if np.ndim(value):
        return [plain(inner) for inner in value]
    return round(float(value), 12) if float(value) % 1 else int(value)


def main() -> None:
    """Write all benchmarks."""
    found = {}
    for name in ("kitti", "MOT17", "MOT20", "MOT15"):
        with tempfile.TemporaryDirectory() as folder:
            found[name] = plain(kitti(Path(folder)) if name == "kitti" else mot(Path(folder), name))
    path = Path(__file__).with_name("trackeval.json")
    path.write_text(json.dumps(found, separators=(",", ":")).replace('},"', '},\n"') + "\n")


if __name__ == "__main__":
    main()
