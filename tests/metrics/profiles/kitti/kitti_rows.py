"""Sequences from lines of KITTI's tracking labels and results."""

import numpy as np

from fbench.replay.data.sequences import Objects, Sequence, Steps


def tracking_objects(lines: list[str]) -> Objects:
    """Read lines: frame, id, class and numbers; results have a score at the end. Solids are x forward, z up."""
    rows = sorted((line.split() for line in lines), key=lambda fields: int(fields[0]))
    v = np.array([[float(x) for x in r[3:17]] for r in rows]).reshape(-1, 14)
    h, x, y, z, turn = v[:, 7], v[:, 10], v[:, 11], v[:, 12], v[:, 13]
    return Objects(
        step=np.array([int(r[0]) for r in rows], np.int64),
        label=np.array([r[2].lower() for r in rows], np.str_),
        track_id=np.array([int(float(r[1])) for r in rows], np.int64),
        score=np.array([float(r[17]) if len(r) > 17 else 0.0 for r in rows]),
        xyxy_px=v[:, 3:7],
        center_m=np.column_stack([z, -x, h / 2 - y]),
        size_lwh_m=np.column_stack([v[:, 9], v[:, 8], h]),
        yaw_rad=-turn - np.pi / 2,
        occlusion=np.where(v[:, 1] < 0, np.nan, v[:, 1]),
        truncation=np.where(v[:, 0] < 0, np.nan, v[:, 0]),
    )


def tracking_sequence(name: str, truth: list[str], results: list[str], num_frames: int) -> Sequence:
    """One sequence of `num_frames` frames."""
    return Sequence(name, Steps.of_one_stream(num_frames), tracking_objects(truth), tracking_objects(results))
