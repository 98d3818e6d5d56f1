"""Sequences and problems written down box by box."""

from collections.abc import Sequence as Rows

import numpy as np

from fbench.replay.data.sequences import Objects, Sequence, Steps

Row = tuple[int, int, float]
"""Step, id, left edge [px]; boxes are 10 by 40, so that a shift by d has IoU (10 - d) / (10 + d)."""


def boxes(rows: Rows[Row], label: str = "car", **columns) -> Objects:
    rows = sorted(rows, key=lambda row: row[0])
    left = np.array([row[2] for row in rows], float)
    xyxy = np.stack([left, 0 * left, left + 10, 0 * left + 40], axis=1).reshape(-1, 4)
    return Objects(
        step=np.array([row[0] for row in rows], np.int64),
        label=np.full(len(rows), label),
        track_id=np.array([row[1] for row in rows], np.int64),
        score=np.ones(len(rows)),
        xyxy_px=xyxy,
        **columns,
    )


def sequence(truth: Rows[Row], estimates: Rows[Row], num: int | None = None, name: str = "s", **columns) -> Sequence:
    last = max((row[0] for row in (*truth, *estimates)), default=-1)
    steps = Steps.of_one_stream(last + 1 if num is None else num)
    return Sequence(name, steps, boxes(truth, **columns), boxes(estimates))


def track(id_: int, steps: Rows[int], left: float = 0.0) -> list[Row]:
    return [(step, id_, left) for step in steps]
