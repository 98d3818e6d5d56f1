"""nuScenes submissions: read and write results by sample token, in the world.

(https://github.com/nutonomy/nuscenes-devkit, `eval/detection/README.md` and `eval/tracking/README.md`).

(https://github.com/nutonomy/nuscenes-devkit, `eval/detection/README.md` and `eval/tracking/README.md`).
"""

import csv
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import Kind
from fbench.replay.formats.class_names import namer
from fbench.replay.formats.documents import items, mapping, member, read_json, scalar, text, vector
from fbench.replay.formats.export_request import ExportWish, LeftOut
from fbench.replay.formats.objects import Labelled, Solid, angles, solids, track_number
from fbench.replay.formats.placing import placed
from fbench.replay.formats.sequence import BoxFrame, BoxSequence, usable
from fbench.replay.geometry.transforms import transform
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

COMPANIONS = ("sample.json", "samples.csv")
_FRAMES_BELOW = 10_000_000
"""Tokens that are smaller numbers count frames, others are stamps."""
_MAX_NS = 2**63 - 1


def open_nuscenes(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read a submission. When a token was is what a `sample.json` (the table of nuScenes) or `samples.csv` (columns
    `token` and `stamp_ns`) beside it says; without one, tokens are numbers of frames or stamps [ns] themselves.

    Raises:
        LogError: where the form isn't that of a submission, or nobody knows a token.
    """
    where = str(source.path)
    results = member(read_json(source.path), "results", where)
    if not results:
        raise LogError(f"{where}: no results; expected an object with 'results' by sample token")
    instant = _clock(source.path)
    ordered = sorted((instant(token), token) for token in results)
    for (stamp_ns, frame), token in ordered:
        at = f"{where}: sample '{token[:40]}'"
        objects = [labelled_box(item, f"{at} box {i}") for i, item in enumerate(items(results[token], at))]
        frames = [source.frame or "world"] * max(len(objects), 1)
        boxes, in_world = placed(solids(objects), frames, coordinates, at)
        counted = None if frame < 0 else frame
        yield Truth(stamp_ns, stamp_ns, boxes, None, counted, counted, in_world)


def labelled_box(value: object, where: str) -> Labelled:
    """Return the object of a box of a submission, in the world.

    Raises:
        LogError: saying what is missing or wrong.
    """
    box = mapping(value, where)
    name = text(box.get("tracking_name", box.get("detection_name")), f"{where}: detection_name")
    if not name:
        raise LogError(f"{where}: neither detection_name nor tracking_name")
    score = box.get("tracking_score", box.get("detection_score"))
    id_ = box.get("tracking_id")
    points = box.get("num_pts")
    return Labelled(
        name, _solid(box, where),
        score=None if score is None else scalar(score, f"{where}: score"),
        track_id=None if id_ is None else track_number(str(id_)),
        attribute=text(box.get("attribute_name"), f"{where}: attribute_name") or None,
        num_lidar_pts=int(points) if isinstance(points, int) and 0 <= points < 2**31 else None,
    )  # fmt: skip


def _solid(box: Mapping[str, Any], where: str) -> Solid:
    """Sizes are width, length, height there, quaternions w, x, y, z."""
    x, y, z = vector(box.get("translation"), (3,), f"{where}: translation")
    width, length, height = vector(box.get("size"), (3,), f"{where}: size")
    qw, qx, qy, qz = vector(box.get("rotation"), (4,), f"{where}: rotation")
    told = box.get("velocity")
    velocity = None if told is None else [*vector(told, (2, 3), f"{where}: velocity"), 0.0]
    return Solid(
        (x, y, z), (length, width, height), angles(qx, qy, qz, qw, f"{where}: rotation"),
        None if velocity is None else (velocity[0], velocity[1], velocity[2]),
    )  # fmt: skip


def _clock(path: Path) -> Callable[[str], tuple[int, int]]:
    """Return what tells the stamp of a token, and the number of its frame; 0 and -1 stand for none."""
    companion = next((path.with_name(name) for name in COMPANIONS if path.with_name(name).is_file()), None)
    stamps = {} if companion is None else _companion(companion)

    def instant(token: str) -> tuple[int, int]:
        if token in stamps:
            return stamps[token], -1
        if token.isascii() and token.isdigit() and len(token) < 20 and int(token) <= _MAX_NS:
            number = int(token)
            return (0, number) if number < _FRAMES_BELOW else (number, -1)
        there = f"{companion} doesn't know it" if companion else f"put {' or '.join(COMPANIONS)} beside the file"
        raise LogError(f"{path}: when was sample '{token[:40]}'? {there}")

    return instant


def _companion(path: Path) -> dict[str, int]:
    if path.suffix == ".json":
        rows = [mapping(row, f"{path}: row {i}") for i, row in enumerate(items(read_json(path), str(path)))]
        return {
            str(row.get("token")): _microseconds(row.get("timestamp"), f"{path}: row {i}") for i, row in enumerate(rows)
        }
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return {row["token"]: _stamp(row["stamp_ns"]) for row in csv.DictReader(file)}
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise LogError(f"{path}: expected the columns token and stamp_ns ({error})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def _microseconds(value: object, where: str) -> int:
    if not isinstance(value, int) or not 0 <= value <= _MAX_NS // 1000:
        raise LogError(f"{where}: timestamp isn't a whole number of microseconds")
    return value * 1000


def _stamp(text: str) -> int:
    stamp_ns = int(text)
    if not 0 <= stamp_ns <= _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no stamp")
    return stamp_ns


NAMES = (
    "pedestrian.moving", "pedestrian.sitting_lying_down", "pedestrian.standing", "cycle.with_rider",
    "cycle.without_rider", "vehicle.moving", "vehicle.parked", "vehicle.stopped",
)  # fmt: skip
_MOVING_MPS = 0.2
"""Slower things stand, as baselines of the benchmark have it; measured velocities are never quite 0."""
_BY_CLASS = {
    "pedestrian": ("pedestrian.moving", "pedestrian.standing"),
    "bicycle": ("cycle.with_rider", "cycle.without_rider"),
    "motorcycle": ("cycle.with_rider", "cycle.without_rider"),
    "bus": ("vehicle.moving", "vehicle.stopped"),
    **dict.fromkeys(("car", "truck", "trailer", "construction_vehicle"), ("vehicle.moving", "vehicle.parked")),
}
"""When moving and when not; what isn't here has no attribute."""


def attributes(boxes: Boxes3D, names: Sequence[str], velocity_mps: Float64) -> list[str]:
    """Return the attribute (N,) of boxes: the one that they have, where it is one of nuScenes, else by their speed;
    empty where that isn't known (the devkit takes this, and counts it as wrong).

    Args:
        boxes: N of them.
        names: Their classes as nuScenes calls them.
        velocity_mps: (N, 3) over ground, NaN where unknown.
    """
    own = [""] * len(boxes) if boxes.attribute is None else boxes.attribute.tolist()
    speeds = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]).tolist()
    return [
        told if told in NAMES else _by_speed(name, speed) for told, name, speed in zip(own, names, speeds, strict=True)
    ]


def _by_speed(name: str, speed_mps: float) -> str:
    if np.isnan(speed_mps) or name not in _BY_CLASS:
        return ""
    moving, still = _BY_CLASS[name]
    return moving if speed_mps > _MOVING_MPS else still


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
