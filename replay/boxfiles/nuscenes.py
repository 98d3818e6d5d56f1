"""nuScenes submissions: results by sample token, in the world
(https://github.com/nutonomy/nuscenes-devkit, `eval/detection/README.md` and `eval/tracking/README.md`).
"""

import csv
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fbench.replay.boxfiles.json_file import items, mapping, member, read_json, scalar, text, vector
from fbench.replay.boxfiles.parse import track_number
from fbench.replay.boxfiles.placing import placed
from fbench.replay.boxfiles.rotations import angles
from fbench.replay.boxfiles.rows import Labelled, Solid, solids
from fbench.replay.data import Truth
from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.coordinates import CoordinateFrames
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
