"""KITTI and MOTChallenge text as sequences, read as plainly as can be: for tests and oracles only."""

from pathlib import Path

import numpy as np

from fbench.replay.data.sequences import Objects, Sequence, Steps

MOT_LABELS = (
    "", "pedestrian", "person on vehicle", "car", "bicycle", "motorbike", "non motorized vehicle", "static person",
    "distractor", "occluder", "occluder on the ground", "occluder full", "reflection", "crowd",
)  # fmt: skip


def kitti_objects(text: str) -> Objects:
    rows = sorted((line.split() for line in text.splitlines()), key=lambda row: int(row[0]))
    label = np.array([row[2].lower() for row in rows], np.str_)
    values = np.array([row[:2] + row[3:10] for row in rows], float).reshape(-1, 9)
    return Objects(
        step=values[:, 0].astype(np.int64), label=label, track_id=values[:, 1].astype(np.int64),
        score=np.ones(len(rows)), xyxy_px=values[:, 5:9], truncation=values[:, 2], occlusion=values[:, 3],
    )  # fmt: skip


def kitti_sequence(name: str, truth: str, results: str, num_frames: int) -> Sequence:
    return Sequence(name, Steps.of_one_stream(num_frames), kitti_objects(truth), kitti_objects(results))


def mot_objects(text: str, is_truth: bool) -> Objects:
    rows = sorted((line.split(",") for line in text.splitlines()), key=lambda row: int(row[0]))
    values = np.array([row[:8] for row in rows], float).reshape(-1, 8)
    kind = values[:, 7].astype(int)
    xyxy = np.concatenate([values[:, 2:4], values[:, 2:4] + values[:, 4:6]], axis=1)
    return Objects(
        step=values[:, 0].astype(np.int64) - 1,
        label=np.array([MOT_LABELS[k] if is_truth else "pedestrian" for k in kind], np.str_),
        track_id=values[:, 1].astype(np.int64), score=values[:, 6], xyxy_px=xyxy,
        ignore=values[:, 6].astype(int) == 0 if is_truth else None,
    )  # fmt: skip


def mot_sequence(name: str, truth: str, results: str, num_frames: int) -> Sequence:
    return Sequence(name, Steps.of_one_stream(num_frames), mot_objects(truth, True), mot_objects(results, False))


def lengths(seqmap: Path) -> dict[str, int]:
    rows = (line.split() for line in seqmap.read_text().splitlines())
    return {row[0]: int(row[3]) for row in rows}
