"""Write `motmetrics.json`: what py-motmetrics 1.4.0 says of `made_tracks.py`.

In an environment of its own (its distances need numpy below 2):

    python -m venv mm && mm/bin/pip install motmetrics==1.4.0 "numpy<2" "pandas<3"
    mm/bin/python -m tests.metrics.tracking.oracles.make_motmetrics

Made with numpy 1.26.4, pandas 2.3.3 and scipy 1.17.1. Truth flagged 0 is left out, as its own MOTChallenge program
does. Undefined numbers are null.
"""

import json
import math
from pathlib import Path

import motmetrics as mm  # type: ignore[import-not-found]
import numpy as np
from tests.metrics.tracking.oracles.made_tracks import MOT_NAMES, NUM_FRAMES, mot_texts


def rows(text: str) -> np.ndarray:
    """Frame, id, left, top, width, height, flag."""
    return np.array([line.split(",")[:7] for line in text.splitlines()], float).reshape(-1, 7)


def accumulated(name: str) -> mm.MOTAccumulator:
    """All frames of a sequence, boxes in the order of the text."""
    truth, results = map(rows, mot_texts(name))
    truth = truth[truth[:, 6] >= 1]
    accumulator = mm.MOTAccumulator(auto_id=True)
    for frame in range(1, NUM_FRAMES + 1):
        a, b = truth[truth[:, 0] == frame], results[results[:, 0] == frame]
        distances = mm.distances.iou_matrix(a[:, 2:6], b[:, 2:6], max_iou=0.5)
        accumulator.update(a[:, 1].astype(int), b[:, 1].astype(int), distances)
    return accumulator


def main() -> None:
    """Write all sequences, and all together."""
    host, names = mm.metrics.create(), mm.metrics.motchallenge_metrics
    table = host.compute_many(
        [accumulated(name) for name in MOT_NAMES], metrics=names, names=list(MOT_NAMES), generate_overall=True
    )
    found = {
        str(name): {metric: (float(v) if math.isfinite(v) else None) for metric, v in row.items()}
        for name, row in table.iterrows()
    }
    Path(__file__).with_name("motmetrics.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
