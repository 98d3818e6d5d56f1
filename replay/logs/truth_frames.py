"""Moving recorded boxes from the coordinate frame of their message into that of the body."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.errors import DecodeError
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.logs.coordinates import WORLDS
from fbench.replay.logs.tree import TransformTree
from fbench.replay.logs.truth_part import TruthPart


def in_body(
    part: TruthPart, tree: TransformTree, body: str, cameras: Mapping[str, str], has_poses: bool = False
) -> TruthPart:
    """Return 3D boxes in body coordinates, and 2D boxes with the name of the camera whose coordinate frame it is.

    Where the log has poses, boxes in a coordinate frame that stands still are left in it, and say so.

    Raises:
        DecodeError: where nothing links the boxes' coordinate frame to the body, or no camera has it.
    """
    truth = part.truth
    if truth.boxes3d is not None and has_poses and part.frame_id in WORLDS and tree.pose(part.frame_id, body) is None:
        truth = replace(truth, in_world=True)
    elif truth.boxes3d is not None and part.frame_id != body:
        truth = replace(truth, boxes3d=_moved(truth.boxes3d, part.frame_id, tree, body))
    if truth.boxes2d is not None:
        if part.frame_id not in cameras:
            raise DecodeError(f"boxes in '{part.frame_id}', which no camera has")
        truth = replace(truth, boxes2d=_named(truth.boxes2d, cameras[part.frame_id]))
    return replace(part, truth=truth, frame_id="")


def _named(boxes: Boxes2D, camera: str) -> Boxes2D:
    return replace(boxes, camera=np.full(len(boxes), camera))


def _moved(boxes: Boxes3D, frame: str, tree: TransformTree, body: str) -> Boxes3D:
    pose = tree.pose(frame, body)
    if pose is None:
        raise DecodeError(f"boxes in '{frame}', which no fixed transform links to '{body}'")
    body_T_frame = pose_matrix(*pose)
    zeros = np.zeros(len(boxes))
    angles = np.stack([boxes.yaw_rad, *(zeros if a is None else a for a in (boxes.pitch_rad, boxes.roll_rad))], axis=1)
    turned = (
        (Rotation.from_quat(pose[1]) * Rotation.from_euler("ZYX", angles)).as_euler("ZYX") if len(boxes) else angles
    )
    rotation = body_T_frame.copy()
    rotation[:3, 3] = 0
    return replace(
        boxes, center_m=transform(body_T_frame, boxes.center_m), yaw_rad=turned[:, 0], pitch_rad=turned[:, 1],
        roll_rad=turned[:, 2],
        velocity_mps=None if boxes.velocity_mps is None else transform(rotation, boxes.velocity_mps),
    )  # fmt: skip
