"""Sequences from made-up frames of the object benchmark."""

import numpy as np
from tests.metrics.profiles.kitti.oracles.kitti_objects_input import Rows

from fbench.replay.data.sequences import Objects, Sequence, Steps


def objects_of(frames: list[Rows]) -> Objects:
    """Boxes of frames in the order of their rows; solids are x forward, z up."""
    columns = {name: np.concatenate([getattr(rows, name) for rows in frames]) for name in Rows.__dataclass_fields__}
    lhw, place = columns["lhw"], columns["location"]
    return Objects(
        step=np.repeat(np.arange(len(frames)), [len(rows.name) for rows in frames]),
        label=np.char.lower(columns["name"]),
        track_id=np.full(len(lhw), -1),
        score=columns["score"],
        xyxy_px=columns["bbox"],
        center_m=np.column_stack([place[:, 2], -place[:, 0], lhw[:, 1] / 2 - place[:, 1]]),
        size_lwh_m=lhw[:, [0, 2, 1]],
        yaw_rad=-columns["rotation_y"] - np.pi / 2,
        alpha_rad=columns["alpha"],
        occlusion=columns["occluded"],
        truncation=columns["truncated"],
    )


def object_sequence(name: str, frames: list[tuple[Rows, Rows]]) -> Sequence:
    """One sequence of frames."""
    truth, results = (objects_of([frame[side] for frame in frames]) for side in (0, 1))
    return Sequence(name, Steps.of_one_stream(len(frames)), truth, results)
