"""nuScenes submissions: results by sample token, in the world
(https://github.com/nutonomy/nuscenes-devkit, `eval/detection/README.md` and `eval/tracking/README.md`).
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.arrays import Float64, Int64
from fbench.replay.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.data import Kind
from fbench.replay.errors import LogError
from fbench.replay.export.attributes import attributes
from fbench.replay.export.classes import namer
from fbench.replay.export.sequence import BoxFrame, BoxSequence, usable
from fbench.replay.export.wish import ExportWish, LeftOut
from fbench.replay.geometry.transforms import transform

MAX_BOXES = 500
"""Of a sample; the devkit refuses more."""
TOKENS = "nuscenes.sample_tokens"
"""Metadata of a log: the tokens of its keyframes with blanks between, that of frame number 0 first."""
_SURE = 1.0
"""Score of boxes that have none."""
_METRE_DIGITS, _TURN_DIGITS = 6, 12

Samples = Iterator[tuple[str, list[dict[str, Any]]]]


def nuscenes_samples(sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Samples:
    """Yield each sample of a log by its token, also those without boxes; of more than `MAX_BOXES` those with the
    highest scores stay.

    Raises:
        LogError: where the log doesn't tell its tokens or poses, or boxes have no class or are in images.
    """
    tokens = _tokens(sequence)
    frames = _frames(sequence, len(tokens))
    writer = _Writer(sequence, wish, left)
    for number, token in enumerate(tokens):
        yield token, writer.sample(token, frames[number]) if number in frames else []


def meta(kinds: Collection[Kind]) -> dict[str, bool]:
    """Say which sensors results come from."""
    used = {f"use_{kind}": kind in kinds for kind in ("camera", "lidar", "radar")}
    return {**used, "use_map": False, "use_external": False}


def _tokens(sequence: BoxSequence) -> list[str]:
    tokens = sequence.metadata.get(TOKENS, "").split()
    if not tokens:
        raise LogError(
            f"{sequence.where}: its log has no nuScenes sample tokens (metadata '{TOKENS}'), without which there is "
            "no submission; only logs that `fbench log import nuscenes` wrote have them, and runs without --redact"
        )
    if len(set(tokens)) < len(tokens):
        raise LogError(f"{sequence.where}: a sample token is twice in the metadata '{TOKENS}'")
    return tokens


def _frames(sequence: BoxSequence, num_tokens: int) -> dict[int, BoxFrame]:
    """Keyframes by number; what is between them isn't part of a submission."""
    frames: dict[int, BoxFrame] = {}
    for frame in sequence.frames:
        if frame.number is None:
            continue
        if frame.number >= num_tokens or frame.number in frames:
            why = "is there twice" if frame.number in frames else f"has no sample token, there are {num_tokens}"
            raise LogError(f"{sequence.where}: keyframe {frame.number} {why}")
        if frame.boxes3d is None and frame.boxes2d is not None:
            raise LogError(f"{sequence.where}: has boxes in images, but nuScenes scores boxes in 3D")
        frames[frame.number] = frame
    if frames and all(frame.world_T_body is None for frame in frames.values()):
        raise LogError(
            f"{sequence.where}: no pose of the body is known at its keyframes, so boxes can't go to the world"
        )
    return frames


class _Writer:
    """Writes the samples of one sequence."""

    def __init__(self, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> None:
        self._names, self._left, self._wish = namer(wish, sequence.where), left, wish

    def sample(self, token: str, frame: BoxFrame) -> list[dict[str, Any]]:
        """Return the boxes of a keyframe."""
        boxes = usable(frame.boxes3d, self._left)
        if boxes is None or not len(boxes):
            return []
        if frame.world_T_body is None or not (np.abs(frame.world_T_body) < MAX_MAGNITUDE).all():
            self._left.add("at frames without a pose of the body", len(boxes))
            return []
        nothing = np.full(len(boxes), "")
        columns = (nothing if column is None else column for column in (boxes.source_label, boxes.label))
        names = np.array(self._names(*columns), dtype=object)
        rows = self._chosen(boxes, names)
        return _results(token, boxes[rows], names[rows].tolist(), frame.world_T_body, self._wish.is_tracking)

    def _chosen(self, boxes: Boxes3D, names: "np.ndarray[Any, np.dtype[np.object_]]") -> Int64:
        """Rows that have a class, an id where that is needed, and not too many."""
        kept = names != ""
        self._left.add("of classes that nuScenes doesn't score", int(np.count_nonzero(~kept)))
        if boxes.ignore is not None:
            self._left.add("to be ignored", int(np.count_nonzero(kept & boxes.ignore)))
            kept = kept & ~boxes.ignore
        if self._wish.is_tracking:
            known = np.zeros(len(boxes), bool) if boxes.track_id is None else boxes.track_id >= 0
            self._left.add("without a track id", int(np.count_nonzero(kept & ~known)))
            kept = kept & known
        rows = np.flatnonzero(kept)
        best = rows[np.argsort(-_scores(boxes)[rows], kind="stable")[:MAX_BOXES]]
        self._left.add(f"beyond the {MAX_BOXES} of a sample with the highest scores", len(rows) - len(best))
        return np.sort(best)


def _scores(boxes: Boxes3D) -> Float64:
    return np.full(len(boxes), _SURE) if boxes.score is None else boxes.score


def _results(
    token: str, boxes: Boxes3D, names: Sequence[str], world_T_body: Float64, is_tracking: bool
) -> list[dict[str, Any]]:
    velocity_mps = _velocities(boxes, world_T_body)
    centers = _rounded(transform(world_T_body, boxes.center_m), _METRE_DIGITS)
    sizes = _rounded(boxes.size_lwh_m[:, [1, 0, 2]], _METRE_DIGITS)
    turns = _rounded(_quaternions_wxyz(boxes, world_T_body), _TURN_DIGITS)
    # The format has no way to say that a velocity isn't known.
    velocities = _rounded(np.nan_to_num(velocity_mps[:, :2]), _METRE_DIGITS)
    scores = _rounded(_scores(boxes), _METRE_DIGITS)
    ids = np.full(len(boxes), -1) if boxes.track_id is None else boxes.track_id
    told = attributes(boxes, names, velocity_mps)
    return [
        {
            "sample_token": token, "translation": centers[i], "size": sizes[i], "rotation": turns[i],
            "velocity": velocities[i],
            **(
                {"tracking_id": str(ids[i]), "tracking_name": name, "tracking_score": scores[i]}
                if is_tracking
                else {"detection_name": name, "detection_score": scores[i], "attribute_name": told[i]}
            ),
        }
        for i, name in enumerate(names)
    ]  # fmt: skip


def _velocities(boxes: Boxes3D, world_T_body: Float64) -> Float64:
    """Over ground, in the axes of the world (N, 3); NaN where unknown."""
    if boxes.velocity_mps is None:
        return np.full((len(boxes), 3), np.nan)
    turn = world_T_body.copy()
    turn[:3, 3] = 0
    known = np.abs(boxes.velocity_mps).max(axis=1, keepdims=True) < MAX_MAGNITUDE  # also false for NaN
    return transform(turn, np.where(known, boxes.velocity_mps, np.nan))


def _quaternions_wxyz(boxes: Boxes3D, world_T_body: Float64) -> Float64:
    zeros = np.zeros(len(boxes))
    pitch, roll = (zeros if angle is None else angle for angle in (boxes.pitch_rad, boxes.roll_rad))
    body_R_box = Rotation.from_euler("ZYX", np.stack([boxes.yaw_rad, pitch, roll], axis=1))
    world_R_box = Rotation.from_matrix(world_T_body[:3, :3]) * body_R_box
    return np.asarray(world_R_box.as_quat(canonical=True)[:, [3, 0, 1, 2]], np.float64)


def _rounded(values: Float64, digits: int) -> list[Any]:
    rounded = np.round(values, digits) + 0.0  # no negative zeros
    return list(rounded.tolist())
