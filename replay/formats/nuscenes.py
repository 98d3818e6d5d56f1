"""nuScenes submissions: read and write results by sample token, in the world; see `eval/detection/README.md` and
`eval/tracking/README.md` of https://github.com/nutonomy/nuscenes-devkit.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Float64, Int64, text_array
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.formats.documents import items, mapping, member, read_json, scalar, text, vector
from fbench.replay.formats.export_request import ExportRequest, LeftOut, namer
from fbench.replay.formats.objects import Columns, LabeledObject, Solid, angles, place, to_boxes3d, to_columns
from fbench.replay.formats.recognition import COMPANIONS
from fbench.replay.formats.sequence import BoxFrame, BoxSequence, drop_unusable
from fbench.replay.formats.text import track_number
from fbench.replay.geometry.transforms import transform
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

FRAMES_BELOW = 10_000_000  # Tokens that are smaller numbers count frames, others are stamps
UNKNOWN_EGO = (np.nan,) * 3
_MAX_NS = 2**63 - 1
ATTRIBUTES = (
    "pedestrian.moving", "pedestrian.sitting_lying_down", "pedestrian.standing", "cycle.with_rider",
    "cycle.without_rider", "vehicle.moving", "vehicle.parked", "vehicle.stopped",
)  # fmt: skip
_MOVING_MPS = 0.2  # Slower things stand, as baselines of the benchmark have it; measured velocities are never quite 0
_BY_CLASS = {
    "pedestrian": ("pedestrian.moving", "pedestrian.standing"),
    "bicycle": ("cycle.with_rider", "cycle.without_rider"),
    "motorcycle": ("cycle.with_rider", "cycle.without_rider"),
    "bus": ("vehicle.moving", "vehicle.stopped"),
    **dict.fromkeys(("car", "truck", "trailer", "construction_vehicle"), ("vehicle.moving", "vehicle.parked")),
}
"""When moving and when not; what isn't here has no attribute."""
MAX_BOXES = 500  # Of a sample; the devkit refuses more
TOKENS = "nuscenes.sample_tokens"  # Metadata of a log: tokens of its keyframes by frame number, blanks between
_SURE = 1.0  # Score of boxes that have none
_METER_DIGITS, _TURN_DIGITS = 6, 12


@dataclass(frozen=True)
class Sample:
    """When and in which scene a sample is."""

    key: int  # Stamp [ns]; number of the frame where no stamps are known
    scene: str = ""
    ego_m: tuple[float, float, float] = UNKNOWN_EGO  # Where the body is


def find_companion(path: Path) -> Path | None:
    """Return the table of samples beside a submission."""
    return next((path.with_name(name) for name in COMPANIONS if path.with_name(name).is_file()), None)


def read_samples(path: Path) -> dict[str, Sample]:
    """Read a `sample.json`, the table of nuScenes, or a `samples.csv` (columns `token`, `stamp_ns`, and where known
    `scene`, `ego_x`, `ego_y`, `ego_z`). Raises LogError where it can't be read.
    """
    samples: dict[str, Sample] = {}
    if path.suffix == ".json":
        for i, value in enumerate(items(read_json(path), str(path))):
            row = mapping(value, f"{path}: row {i}")
            stamp_us = row.get("timestamp")
            if isinstance(stamp_us, bool) or not isinstance(stamp_us, int) or not 0 <= stamp_us <= _MAX_NS // 1000:
                raise LogError(f"{path}: row {i}: timestamp isn't a whole number of microseconds")
            samples[str(row.get("token"))] = Sample(stamp_us * 1000, str(row.get("scene_token") or ""))
        return samples
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for row in csv.DictReader(file):
                token, stamp_ns = row["token"], int(row["stamp_ns"])
                if not 0 <= stamp_ns <= _MAX_NS:
                    raise ValueError(f"'{row['stamp_ns'][:40]}' is no stamp")
                x, y, z = (float(row.get(name) or "nan") for name in ("ego_x", "ego_y", "ego_z"))
                samples[token] = Sample(stamp_ns, row.get("scene") or "", (x, y, z))
        return samples
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise LogError(f"{path}: expected the columns token and stamp_ns ({error})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def read_submission(path: Path) -> tuple[Mapping[str, Any], bool]:
    """Return results by sample token, and whether there is `meta`. Raises LogError where it isn't a submission."""
    content = read_json(path)
    if not (results := member(content, "results", str(path))):
        raise LogError(f"{path}: no results; expected an object with 'results' by sample token")
    return results, "meta" in content


def open_nuscenes(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read a submission. When a token was says the table of samples beside it (see `read_samples`); without one, tokens
    are numbers of frames or stamps [ns]. Raises LogError where it isn't a submission, or nobody knows a token.
    """
    where, (results, _) = str(source.path), read_submission(source.path)
    companion = find_companion(source.path)
    samples = {} if companion is None else read_samples(companion)

    def instant(token: str) -> tuple[int, int]:
        """Stamp and number of the frame; 0 and -1 stand for none."""
        if token in samples:
            return samples[token].key, -1
        if token.isascii() and token.isdigit() and len(token) < 20 and int(token) <= _MAX_NS:
            number = int(token)
            return (0, number) if number < FRAMES_BELOW else (number, -1)
        there = f"{companion} doesn't know it" if companion else f"put {' or '.join(COMPANIONS)} beside the file"
        raise LogError(f"{source.path}: when was sample '{token[:40]}'? {there}")

    for (stamp_ns, frame), token in sorted((instant(token), token) for token in results):
        at = f"{where}: sample '{token[:40]}'"
        objects = [parse_box(item, f"{at} box {i}") for i, item in enumerate(items(results[token], at))]
        frames = [source.frame or "world"] * max(len(objects), 1)
        boxes, in_world = place(to_boxes3d(objects), frames, coordinates, at)
        number = None if frame < 0 else frame
        yield Truth(stamp_ns, stamp_ns, boxes, None, number, number, in_world)


def parse_box(value: object, where: str) -> LabeledObject:
    """Return the object of a box, in the world (size w, l, h; quaternion w, x, y, z). LogError says what is wrong."""
    box = mapping(value, where)
    name = text(box.get("tracking_name", box.get("detection_name")), f"{where}: detection_name")
    if not name:
        raise LogError(f"{where}: neither detection_name nor tracking_name")
    x, y, z = vector(box.get("translation"), (3,), f"{where}: translation")
    width, length, height = vector(box.get("size"), (3,), f"{where}: size")
    qw, qx, qy, qz = vector(box.get("rotation"), (4,), f"{where}: rotation")
    velocity = None
    if (given := box.get("velocity")) is not None:
        vx, vy, vz, *_ = [*vector(given, (2, 3), f"{where}: velocity"), 0.0]
        velocity = vx, vy, vz
    turn = angles(qx, qy, qz, qw, f"{where}: rotation")
    score = box.get("tracking_score", box.get("detection_score"))
    id_, points = box.get("tracking_id"), box.get("num_pts")
    return LabeledObject(
        name,
        Solid((x, y, z), (length, width, height), turn, velocity),
        score=None if score is None else scalar(score, f"{where}: score"),
        track_id=None if id_ is None else track_number(str(id_)),
        attribute=text(box.get("attribute_name"), f"{where}: attribute_name") or None,
        num_lidar_pts=int(points) if isinstance(points, int) and 0 <= points < 2**31 else None,
    )


def to_box_columns(boxes: Sequence[tuple[str, Mapping[str, Any]]], steps: Sequence[int]) -> Columns:
    """Return boxes, each with its name in errors and the key of its sample, as columns: all at once where every box is
    as it should be; else one by one, which says what is wrong. Raises LogError as `parse_box`.
    """
    try:
        return _columns_at_once([box for _, box in boxes], steps) if boxes else to_columns([], [])
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError):
        return to_columns(steps, [parse_box(box, where) for where, box in boxes])


def _columns_at_once(boxes: Sequence[Mapping[str, Any]], steps: Sequence[int]) -> Columns:
    task = "tracking" if "tracking_name" in boxes[0] else "detection"
    names = [box[f"{task}_name"] for box in boxes]
    scores = [box.get(f"{task}_score", 0.0) for box in boxes]
    if any(isinstance(score, bool) or not isinstance(score, int | float) for score in scores):
        raise TypeError("score")
    points = [box.get("num_pts", -1) for box in boxes]
    if any(isinstance(num, bool) or not isinstance(num, int) or num >= 2**31 for num in points):
        raise TypeError("num_pts")
    velocity = _vectors(boxes, "velocity", 2) if "velocity" in boxes[0] else None
    w, x, y, z = _vectors(boxes, "rotation", 4).T
    norm = w * w + x * x + y * y + z * z
    if not (np.isfinite(norm) & (norm > 0)).all():  # left to `parse_box`
        raise ValueError("rotation")
    is_upright, headings = (x == 0) & (y == 0), np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return {
        "step": np.array(steps, np.int64),
        "label": text_array([name.lower() for name in names]),
        "track_id": np.array([track_number(str(box.get("tracking_id", ""))) for box in boxes], np.int64),
        "score": np.array([float(score) for score in scores]),
        "center_m": _vectors(boxes, "translation", 3),
        "size_lwh_m": _vectors(boxes, "size", 3)[:, [1, 0, 2]],
        "yaw_rad": np.where(is_upright, 2 * np.arctan2(z, w), headings),
        "velocity_mps": None if velocity is None else np.pad(velocity, ((0, 0), (0, 1))),
        "attribute": text_array([box.get("attribute_name") or "" for box in boxes]),
        "num_points": np.maximum(np.array(points, np.int64), -1) if max(points) >= 0 else None,
    }


def _vectors(boxes: Sequence[Mapping[str, Any]], name: str, length: int) -> Float64:
    found = np.array([box[name] for box in boxes])
    if found.shape != (len(boxes), length) or found.dtype.kind not in "if":
        raise ValueError(name)
    return found.astype(np.float64)


def attributes(boxes: Boxes3D, names: Sequence[str], velocity_mps: Float64) -> list[str]:
    """Return the attribute (N,) of boxes by their classes in nuScenes and velocities (N, 3) over ground, NaN where
    unknown: the one that they have, where it is one of nuScenes, else by their speed; empty where that isn't known (the
    devkit takes this, and counts it as wrong).
    """
    found = [""] * len(boxes) if boxes.attribute is None else boxes.attribute.tolist()
    speeds = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]).tolist()
    for i, (name, speed) in enumerate(zip(names, speeds, strict=True)):
        if found[i] not in ATTRIBUTES:
            moving, still = ("", "") if np.isnan(speed) else _BY_CLASS.get(name, ("", ""))
            found[i] = moving if speed > _MOVING_MPS else still
    return found


def nuscenes_samples(
    sequence: BoxSequence, request: ExportRequest, left: LeftOut
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield each sample of a log by its token, also those without boxes; of more than `MAX_BOXES` those with the
    highest scores stay. LogError: the log doesn't tell tokens or poses, or boxes have no class or are in images.
    """
    tokens = sequence.metadata.get(TOKENS, "").split()
    if not tokens:
        what = f"its log has no nuScenes sample tokens (metadata '{TOKENS}'), without which there is no submission"
        who = "only logs that `fbench log import nuscenes` wrote have them, and runs without --redact"
        raise LogError(f"{sequence.where}: {what}; {who}")
    if len(set(tokens)) < len(tokens):
        raise LogError(f"{sequence.where}: a sample token is twice in the metadata '{TOKENS}'")
    frames = _frames(sequence, len(tokens))
    name_classes = namer(request, sequence.where)
    for number, token in enumerate(tokens):
        boxes = drop_unusable(frames[number].boxes3d, left) if number in frames else None
        if boxes is None or not len(boxes):
            yield token, []
            continue
        pose, nothing = frames[number].world_T_body, np.full(len(boxes), "")
        if pose is None or not (np.abs(pose) < MAX_MAGNITUDE).all():
            left["at frames without a pose of the body"] += len(boxes)
            yield token, []
            continue
        labels = (nothing if column is None else column for column in (boxes.source_label, boxes.label))
        names = np.array(name_classes(*labels), dtype=object)
        rows = _choose(boxes, names != "", request.is_tracking, left)
        yield token, _results(token, boxes[rows], names[rows].tolist(), pose, request.is_tracking)


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
        why = "no pose of the body is known at its keyframes, so boxes can't go to the world"
        raise LogError(f"{sequence.where}: {why}")
    return frames


def _choose(boxes: Boxes3D, kept: Bool, is_tracking: bool, left: LeftOut) -> Int64:
    """Rows that have a class (`kept`), an id where that is needed, and not too many."""
    left["of classes that nuScenes doesn't score"] += int(np.count_nonzero(~kept))
    if boxes.ignore is not None:
        left["to be ignored"] += int(np.count_nonzero(kept & boxes.ignore))
        kept = kept & ~boxes.ignore
    if is_tracking:
        known = np.zeros(len(boxes), bool) if boxes.track_id is None else boxes.track_id >= 0
        left["without a track id"] += int(np.count_nonzero(kept & ~known))
        kept = kept & known
    rows = np.flatnonzero(kept)
    best = rows[np.argsort(-_scores(boxes)[rows], kind="stable")[:MAX_BOXES]]
    left[f"beyond the {MAX_BOXES} of a sample with the highest scores"] += len(rows) - len(best)
    return np.sort(best)


def _scores(boxes: Boxes3D) -> Float64:
    return np.full(len(boxes), _SURE) if boxes.score is None else boxes.score


def _results(
    token: str, boxes: Boxes3D, names: Sequence[str], world_T_body: Float64, is_tracking: bool
) -> list[dict[str, Any]]:
    from scipy.spatial.transform import Rotation  # takes a while to import

    velocity_mps = np.full((len(boxes), 3), np.nan)  # Over ground, in the axes of the world
    if boxes.velocity_mps is not None:
        turn = world_T_body.copy()
        turn[:3, 3] = 0
        known = np.abs(boxes.velocity_mps).max(axis=1, keepdims=True) < MAX_MAGNITUDE  # also false for NaN
        velocity_mps = transform(turn, np.where(known, boxes.velocity_mps, np.nan))
    zeros = np.zeros(len(boxes))
    pitch, roll = (zeros if angle is None else angle for angle in (boxes.pitch_rad, boxes.roll_rad))
    body_R_box = Rotation.from_euler("ZYX", np.stack([boxes.yaw_rad, pitch, roll], axis=1))
    world_R_box = Rotation.from_matrix(world_T_body[:3, :3]) * body_R_box
    turns = _round(np.asarray(world_R_box.as_quat(canonical=True)[:, [3, 0, 1, 2]], np.float64), _TURN_DIGITS)
    centers = _round(transform(world_T_body, boxes.center_m), _METER_DIGITS)
    sizes = _round(boxes.size_lwh_m[:, [1, 0, 2]], _METER_DIGITS)
    # The format has no way to say that a velocity isn't known.
    velocities = _round(np.nan_to_num(velocity_mps[:, :2]), _METER_DIGITS)
    scores = _round(_scores(boxes), _METER_DIGITS)
    ids = np.full(len(boxes), -1) if boxes.track_id is None else boxes.track_id
    given = attributes(boxes, names, velocity_mps)
    return [
        {
            "sample_token": token, "translation": centers[i], "size": sizes[i], "rotation": turns[i],
            "velocity": velocities[i],
            **(
                {"tracking_id": str(ids[i]), "tracking_name": name, "tracking_score": scores[i]}
                if is_tracking
                else {"detection_name": name, "detection_score": scores[i], "attribute_name": given[i]}
            ),
        }
        for i, name in enumerate(names)
    ]  # fmt: skip


def _round(values: Float64, digits: int) -> list[Any]:
    return list((np.round(values, digits) + 0.0).tolist())  # no negative zeros
