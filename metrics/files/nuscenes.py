"""nuScenes submissions as columns, truth in the same form, and warnings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fbench.metrics.files.side import InputWarning, Side, objects_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.formats import nuscenes
from fbench.replay.formats.documents import items, mapping
from fbench.replay.formats.nuscenes import UNKNOWN_EGO, Sample


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

    @cached_property
    def tokens(self) -> Mapping[str, list[str]]:
        """Those of each scene, in the order of the names of scenes; one without a name where nobody tells."""
        found: dict[str, list[str]] = {}
        for token in self.results:
            found.setdefault(self.samples[token].scene, []).append(token)
        return dict(sorted(found.items()))

    def read(self, scene: str) -> Side:
        """Return the boxes of one scene, in the world. Raises LogError naming sample and box of what can't be read."""
        tokens = sorted(self.tokens[scene], key=lambda token: (self.samples[token].key, token))
        keys = np.array([self.samples[token].key for token in tokens], np.int64)
        if len(keys) and (np.diff(keys) == 0).any():
            raise LogError(f"{self.path}: two samples are at {keys[int(np.argmax(np.diff(keys) == 0))]}")
        boxes, steps, ego_m, warnings = [], [], [], list[InputWarning]()
        for token, key in zip(tokens, keys.tolist(), strict=True):
            at = f"{self.path}: sample '{token[:40]}'"
            found = [mapping(box, f"{at} box {i}") for i, box in enumerate(items(self.results[token], at))]
            boxes += [(f"{at} box {i}", box) for i, box in enumerate(found)]
            steps += [key] * len(found)
            ego_m.append(_ego(self.samples[token], found))
            where = f"{f'scene {scene}, ' if scene else ''}sample '{token[:40]}'"
            warnings += [InputWarning(what, num, where) for what, num in _count_oddities(token, found).items() if num]
        ego = np.array(ego_m, np.float64).reshape(-1, 3)
        return Side(
            objects_of(nuscenes.to_box_columns(boxes, steps))[0],
            keys,
            self.has_stamps,
            space="world",
            ego_m=None if np.isnan(ego).all() else ego,
            are_ordered=self.are_ordered,
            lists_frames=True,
            warnings=tuple(warnings),
        )


def open_submission(path: Path, like: Submission | None = None) -> Submission:
    """Open a submission; what tells samples, `sample.json` or `samples.csv`, lies beside it, or beside `like`, the
    truth that it belongs to. Raises LogError where it isn't one, nobody knows a token, or some samples have a scene and
    others none.
    """
    results, has_meta = nuscenes.read_submission(path)
    companion = nuscenes.find_companion(path)
    has_stamps = are_ordered = True
    if companion is not None:
        samples: Mapping[str, Sample] = nuscenes.read_samples(companion)
    elif like is not None:
        samples, has_stamps, are_ordered = like.samples, like.has_stamps, like.are_ordered
    elif all(token.isascii() and token.isdigit() and len(token) < 19 for token in results):
        samples, has_stamps = (
            {token: Sample(int(token)) for token in results},
            max(map(int, results)) >= nuscenes.FRAMES_BELOW,
        )
    else:
        samples, has_stamps, are_ordered = {t: Sample(key) for key, t in enumerate(sorted(results))}, False, False
    strange = next((token[:40] for token in results if token not in samples), None)
    if strange is not None and companion is not None:
        raise LogError(f"{path}: when was sample '{strange}'? {companion} doesn't know it")
    if strange is not None and like is not None:
        raise LogError(f"{path}: sample '{strange}' isn't in {like.path}")
    lost = [token for token in results if companion is not None and not samples[token].scene]
    if 0 < len(lost) < len(results):
        raise LogError(f"{companion}: sample '{lost[0][:40]}' has no scene, others have one")
    return Submission(path, results, samples, are_ordered, has_stamps, has_meta)


def _count_oddities(token: str, boxes: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many boxes under one sample are odd in which way."""
    flat = [box for box in boxes if "tracking_name" not in box]
    strange = [box for box in flat if box.get("attribute_name") and box["attribute_name"] not in nuscenes.ATTRIBUTES]
    return {
        "box whose sample_token names another sample than it is under":
            sum(box.get("sample_token", token) != token for box in boxes),
        "box with an attribute that nuScenes doesn't have": len(strange),
        "box without a velocity, which counts as unknown": sum(box.get("velocity") is None for box in flat),
    }  # fmt: skip


def _ego(sample: Sample, boxes: Sequence[Mapping[str, Any]]) -> tuple[float, float, float]:
    """Where the body is: as the table of samples says, else as a box does whose place from the body is told too."""
    if not np.isnan(sample.ego_m).any():
        return sample.ego_m
    for box in boxes:
        world, own = box.get("translation"), box.get("ego_translation")
        if isinstance(world, list) and isinstance(own, list) and len(world) == len(own) == 3 and any(own):
            x, y, z = (float(w) - float(o) for w, o in zip(world, own, strict=True))
            return x, y, z
    return UNKNOWN_EGO
