"""Recorded boxes moved to body coordinates, 3D and 2D joined in the order of their stamps."""

import heapq
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.boxes import Boxes3D, concatenate
from fbench.replay.data.messages import Truth
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.coordinate_frames import WORLDS, TransformTree


@dataclass(frozen=True)
class PosesIn:
    """The poses of a log: whether there are any, and in which coordinate frame."""

    are_there: bool
    world: str = ""  # Empty: it isn't told

    def link(self, frame: str, body: str) -> bool:
        """Tell whether poses alone link a coordinate frame to the body. Raises DecodeError where it stands still, but
        poses are in another one.
        """
        if not self.are_there or frame == body or frame not in {*WORLDS, self.world} - {""}:
            return False
        if self.world and frame not in (self.world, WORLDS[0]):
            raise DecodeError(f"boxes in '{frame}', but poses in '{self.world}'; name a topic with poses in '{frame}'")
        return True


def in_body(part: TruthPart, tree: TransformTree, body: str, cameras: Mapping[str, str], poses: PosesIn) -> TruthPart:
    """Return 3D boxes in body coordinates, and 2D boxes with the name of the camera whose coordinate frame it is. Boxes
    in the coordinate frame of the log's poses are left in it, and say so. Raises DecodeError where nothing links the
    boxes' coordinate frame to the body, poses are in another world, or no camera has it.
    """

    def move(boxes: Boxes3D, frame: str) -> Boxes3D:
        pose = tree.pose(frame, body)
        if pose is None:
            raise DecodeError(f"boxes in '{frame}', which no fixed transform links to '{body}'")
        return move_boxes(boxes, pose_matrix(*pose))

    truth, boxes = part.truth, part.truth.boxes3d
    if boxes is not None and part.frame_ids:  # each box from its own coordinate frame
        names, parts, rows = np.array(part.frame_ids, np.str_), [], []
        for frame in dict.fromkeys(part.frame_ids):
            rows.append(np.flatnonzero(names == frame))
            chosen, zeros = boxes[rows[-1]], np.zeros(len(rows[-1]))
            pitch, roll = (zeros if angle is None else angle for angle in (chosen.pitch_rad, chosen.roll_rad))
            is_there = frame in ("", body)
            parts.append(replace(chosen, pitch_rad=pitch, roll_rad=roll) if is_there else move(chosen, frame))
        joined = concatenate(parts)[np.argsort(np.concatenate(rows), kind="stable")]
        truth = replace(truth, boxes3d=joined)
    elif boxes is not None and poses.link(part.frame_id, body):
        # Whatever the tree holds above the body is where it was when the log began.
        truth = replace(truth, in_world=True)
    elif boxes is not None and part.frame_id != body:
        truth = replace(truth, boxes3d=move(boxes, part.frame_id))
    if truth.boxes2d is not None:
        if part.frame_id not in cameras:
            raise DecodeError(f"boxes in '{part.frame_id}', which no camera has")
        camera = np.full(len(truth.boxes2d), cameras[part.frame_id])
        truth = replace(truth, boxes2d=replace(truth.boxes2d, camera=camera))
    return replace(part, truth=truth, frame_id="", frame_ids=())


WINDOW = 256  # Truth is put into the order of its stamps within so many, which bounds memory


def join_parts(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Join parts that come in canonical order, and yield truth by (`stamp_ns`, `log_ns`). What comes more than `WINDOW`
    messages late, after a clock that jumped back, stays where it is.
    """
    heap: list[tuple[int, int, int, Truth]] = []
    for i, truth in enumerate(pair_parts(parts)):
        heapq.heappush(heap, (truth.stamp_ns, truth.log_ns, i, truth))
        if len(heap) > WINDOW:
            yield heapq.heappop(heap)[3]
    while heap:
        yield heapq.heappop(heap)[3]


def pair_parts(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Join parts as they come: both have one `log_ns`, and in canonical order the topic of 3D truth comes first."""
    for _, group in groupby(parts, key=lambda part: part.truth.log_ns):
        truths: list[Truth] = []
        waiting: dict[tuple[int, int | None], list[int]] = {}
        for part in group:
            mates = waiting.setdefault((part.truth.stamp_ns, part.truth.frame_number), [])
            if part.is_2d and mates:
                mate = mates.pop(0)
                truths[mate] = replace(truths[mate], boxes2d=part.truth.boxes2d)
                continue
            if part.expects_2d:
                mates.append(len(truths))
            truths.append(part.truth)
        yield from truths
