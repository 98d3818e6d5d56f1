"""nuScenes submissions as columns, truth in the same form, and warnings."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fbench.metrics.core.sequence import Objects
from fbench.metrics.files.side import Doubt, Side, nothing, objects_of
from fbench.metrics.files.text_rows import columns_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float64, Int64, text_array
from fbench.replay.formats.documents import items, mapping, member, read_json
from fbench.replay.formats.nuscenes import COMPANIONS, labelled_box
from fbench.replay.formats.nuscenes import NAMES as ATTRIBUTES
from fbench.replay.formats.objects import track_number


def doubts_about(token: str, boxes: Sequence[Mapping[str, Any]], scene: str) -> list[Doubt]:
    """Return what is odd about the boxes under one sample."""
    where = f"{f'scene {scene}, ' if scene else ''}sample '{token[:40]}'"
    flat = [box for box in boxes if "tracking_name" not in box]
    strange = [box for box in flat if box.get("attribute_name") and box["attribute_name"] not in ATTRIBUTES]
    nums = {
        "box whose sample_token names another sample than it is under":
            sum(box.get("sample_token", token) != token for box in boxes),
        "box with an attribute that nuScenes doesn't have": len(strange),
        "box without a velocity, which counts as unknown": sum(box.get("velocity") is None for box in flat),
    }  # fmt: skip
    return [Doubt(what, num, where) for what, num in nums.items() if num]


_FRAMES_BELOW = 10_000_000
_NO_EGO = (np.nan,) * 3


@dataclass(frozen=True)
class Sample:
    """When and in which scene a sample is."""

    key: int
    scene: str = ""
    ego_m: tuple[float, float, float] = _NO_EGO


@dataclass(frozen=True)
class Submission:
    """Results by sample token."""

    path: Path
    results: Mapping[str, Any]
    samples: Mapping[str, Sample]
    are_ordered: bool
    has_stamps: bool
    has_meta: bool = True

    @property
    def task(self) -> str:
        """`detection` or `tracking`, as its first box says; empty where there is none."""
        first = next((boxes[0] for boxes in self.results.values() if isinstance(boxes, list) and boxes), None)
        named = isinstance(first, dict) and "tracking_name" in first
        return "" if first is None else "tracking" if named else "detection"

    @property
    def scenes(self) -> tuple[str, ...]:
        """In the order of their names; one without a name where nobody tells."""
        return tuple(sorted(self._tokens))

    @cached_property
    def _tokens(self) -> Mapping[str, list[str]]:
        """Of each scene."""
        found: dict[str, list[str]] = {}
        for token in self.results:
            found.setdefault(self.samples[token].scene, []).append(token)
        return found

    def read(self, scene: str) -> Side:
        """Return the boxes of one scene, in the world.

        Raises:
            LogError: naming sample and box of what can't be read.
        """
        tokens = sorted(self._tokens[scene], key=lambda token: (self.samples[token].key, token))
        keys = np.array([self.samples[token].key for token in tokens], np.int64)
        if len(keys) and (np.diff(keys) == 0).any():
            raise LogError(f"{self.path}: two samples are at {keys[int(np.argmax(np.diff(keys) == 0))]}")
        boxes, steps, ego_m, doubts = [], [], [], list[Doubt]()
        for token, key in zip(tokens, keys.tolist(), strict=True):
            at = f"{self.path}: sample '{token[:40]}'"
            found = [
                (f"{at} box {i}", mapping(box, f"{at} box {i}")) for i, box in enumerate(items(self.results[token], at))
            ]
            boxes += found
            doubts += doubts_about(token, [box for _, box in found], scene)
            steps += [key] * len(found)
            ego_m.append(_ego(self.samples[token], [box for _, box in found]))
        side = _columns(boxes, steps)
        ego = np.array(ego_m, np.float64).reshape(-1, 3)
        return Side(
            side, keys, self.has_stamps, space="world", ego_m=None if np.isnan(ego).all() else ego,
            are_ordered=self.are_ordered, lists_frames=True, doubts=tuple(doubts),
        )  # fmt: skip


def open_submission(path: Path, like: Submission | None = None) -> Submission:
    """Open a submission.

    Args:
        path: A JSON file; what tells samples, `sample.json` or `samples.csv`, lies beside it, or beside `like`.
        like: The truth that it belongs to.

    Raises:
        LogError: where it isn't one, nobody knows a token, or some samples have a scene and others none.
    """
    content = read_json(path)
    results = member(content, "results", str(path))
    if not results:
        raise LogError(f"{path}: no results; expected an object with 'results' by sample token")
    companion = _companion_of(path)
    if companion is None and like is not None:
        strange = next((token for token in results if token not in like.samples), None)
        if strange is not None:
            raise LogError(f"{path}: sample '{strange[:40]}' isn't in {like.path}")
        return Submission(path, results, like.samples, like.are_ordered, like.has_stamps, "meta" in content)
    samples, has_stamps, are_ordered = _samples(path, companion, list(results))
    lost = [token for token in results if not samples[token].scene]
    if 0 < len(lost) < len(results):
        raise LogError(f"{companion}: sample '{lost[0][:40]}' has no scene, others have one")
    return Submission(path, results, samples, are_ordered, has_stamps, "meta" in content)


def _companion_of(path: Path) -> Path | None:
    return next((path.with_name(name) for name in COMPANIONS if path.with_name(name).is_file()), None)


def _samples(path: Path, companion: Path | None, tokens: Sequence[str]) -> tuple[dict[str, Sample], bool, bool]:
    if companion is not None:
        known = _from_json(companion) if companion.suffix == ".json" else _from_csv(companion)
        strange = next((token for token in tokens if token not in known), None)
        if strange is not None:
            raise LogError(f"{path}: when was sample '{strange[:40]}'? {companion} doesn't know it")
        return known, True, True
    if all(token.isascii() and token.isdigit() and len(token) < 19 for token in tokens):
        return {token: Sample(int(token)) for token in tokens}, max(map(int, tokens)) >= _FRAMES_BELOW, True
    return {token: Sample(key) for key, token in enumerate(sorted(tokens))}, False, False


def _from_json(path: Path) -> dict[str, Sample]:
    found = {}
    for i, value in enumerate(items(read_json(path), str(path))):
        row = mapping(value, f"{path}: row {i}")
        stamp_us = row.get("timestamp")
        if isinstance(stamp_us, bool) or not isinstance(stamp_us, int) or not 0 <= stamp_us < 2**63 // 1000:
            raise LogError(f"{path}: row {i}: timestamp isn't a whole number of microseconds")
        found[str(row.get("token"))] = Sample(stamp_us * 1000, str(row.get("scene_token") or ""))
    return found


def _from_csv(path: Path) -> dict[str, Sample]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return {row["token"]: _sample(row) for row in csv.DictReader(file)}
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise LogError(f"{path}: expected the columns token and stamp_ns ({error})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def _sample(row: Mapping[str, str]) -> Sample:
    stamp_ns = int(row["stamp_ns"])
    if not 0 <= stamp_ns < 2**63:
        raise ValueError(f"'{row['stamp_ns'][:40]}' is no stamp")
    x, y, z = (float(row.get(name) or "nan") for name in ("ego_x", "ego_y", "ego_z"))
    return Sample(stamp_ns, row.get("scene") or "", (x, y, z))


def _ego(sample: Sample, boxes: Sequence[Mapping[str, Any]]) -> tuple[float, float, float]:
    """Where the body is: as the table of samples says, else as a box does whose place from the body is told too."""
    if not np.isnan(sample.ego_m).any():
        return sample.ego_m
    for box in boxes:
        world, own = box.get("translation"), box.get("ego_translation")
        if isinstance(world, list) and isinstance(own, list) and len(world) == len(own) == 3 and any(own):
            x, y, z = (float(w) - float(o) for w, o in zip(world, own, strict=True))
            return x, y, z
    return _NO_EGO


def _columns(boxes: Sequence[tuple[str, Mapping[str, Any]]], steps: Sequence[int]) -> Objects:
    """All at once where every box is as it should be; else one by one, which says what is wrong."""
    try:
        return _at_once([box for _, box in boxes], steps) if boxes else nothing()
    except (KeyError, TypeError, ValueError, AttributeError):
        return columns_of(steps, [labelled_box(box, where) for where, box in boxes])


def _at_once(boxes: Sequence[Mapping[str, Any]], steps: Sequence[int]) -> Objects:
    task = "tracking" if "tracking_name" in boxes[0] else "detection"
    names = [box[f"{task}_name"] for box in boxes]
    size_wlh = _vectors(boxes, "size", 3)
    velocity = _vectors(boxes, "velocity", 2) if "velocity" in boxes[0] else None
    found, _ = objects_of(
        {
            "step": np.array(steps, np.int64),
            "label": text_array([name.lower() for name in names]),
            "track_id": np.array([track_number(str(box.get("tracking_id", ""))) for box in boxes], np.int64),
            "score": np.array([_score(box.get(f"{task}_score", 0.0)) for box in boxes]),
            "center_m": _vectors(boxes, "translation", 3),
            "size_lwh_m": size_wlh[:, [1, 0, 2]],
            "yaw_rad": _yaws(_vectors(boxes, "rotation", 4)),
            "velocity_mps": None if velocity is None else np.pad(velocity, ((0, 0), (0, 1))),
            "attribute": text_array([box.get("attribute_name") or "" for box in boxes]),
            "num_points": _points(boxes),
        }
    )
    return found


def _vectors(boxes: Sequence[Mapping[str, Any]], name: str, length: int) -> Float64:
    found = np.array([box[name] for box in boxes])
    if found.shape != (len(boxes), length) or found.dtype.kind not in "if":
        raise ValueError(name)
    return found.astype(np.float64)


def _yaws(wxyz: Float64) -> Float64:
    """Heading of the x axis; what isn't finite is left to `labelled_box`, as is what isn't a rotation."""
    w, x, y, z = wxyz.T
    norm = w * w + x * x + y * y + z * z
    if not (np.isfinite(norm) & (norm > 0)).all():
        raise ValueError("rotation")
    yaw: Float64 = np.where(
        (x == 0) & (y == 0), 2 * np.arctan2(z, w), np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    )
    return yaw


def _score(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("score")
    return float(value)


def _points(boxes: Sequence[Mapping[str, Any]]) -> Int64 | None:
    told = [box.get("num_pts", -1) for box in boxes]
    if any(isinstance(num, bool) or not isinstance(num, int) or num >= 2**31 for num in told):
        raise TypeError("num_pts")
    return np.maximum(np.array(told, np.int64), -1) if max(told) >= 0 else None
