"""KITTI's labels and results, of its object and tracking benchmarks: https://www.cvlibs.net/datasets/kitti, devkits.

The inverse of `boxfiles.kitti_rows`.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.boxfiles.kitti_rows import DONT_CARE
from fbench.replay.data import Rig
from fbench.replay.export.classes import namer
from fbench.replay.export.ids import small_ids
from fbench.replay.export.image_rows import ImageRows, camera_of, image_rows, require_view
from fbench.replay.export.levels import body_T_level, coordinate_frame
from fbench.replay.export.sequence import BoxSequence
from fbench.replay.export.wish import ExportWish, LeftOut
from fbench.replay.geometry.boxes import moved
from fbench.replay.geometry.transforms import inverse

_ALPHA = re.compile(r"alpha=(-?[0-9]{1,4}(?:\.[0-9]{1,9})?)")
"""Attribute of 2D truth: the angle as the label file gave it, which doesn't follow from the box."""
_ZERO = re.compile(r"(?<!\S)-(?=0\.0*(?!\S))")
"""Sign of a number that is rounded to zero."""
_UNKNOWN_BOX = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""Height, width, length, x, y, z, rotation_y of an object without a 3D box."""
_SURE = 1.0
"""Score of results that have none."""
_MARGIN_RAD = 1e-6
"""Labels with six decimals go so far beyond pi."""


@dataclass(frozen=True)
class _Style:
    """How a benchmark writes its labels, to the letter."""

    digits: int
    ignored: str
    """What follows the 2D box of a region that is ignored."""
    ignored_alpha: str


_TRACKING = _Style(6, " ".join(f"{value:.6f}" for value in (-1000, -1000, -1000, -10, -1, -1, -1)), "-10.000000")
"""The numbers of its ignored regions are in another order than in the object benchmark."""
_OBJECT = _Style(2, "-1 -1 -1 -1000 -1000 -1000 -10", "-10")


def kitti_rows(sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each frame and its rows; those of the tracking benchmark begin with frame and id.

    Truth that came from KITTI's labels gives the same rows again. Results have truncated and occluded -1 and a score
    at the end. Boxes stand upright in KITTI: of those that are tilted only the heading is kept.

    Raises:
        ConfigError: where a camera or coordinate frame isn't known.
        LogError: where boxes have no class, or can't be projected.
    """
    camera = camera_of(sequence, wish.camera)
    require_view(sequence, camera)
    writer = _Writer(sequence, wish, camera, left)
    for number, frame in zip(sequence.numbers(), sequence.frames, strict=True):
        yield number, writer.texts(number, image_rows(frame, camera, left), frame.rig)


class _Writer:
    """Writes the rows of one sequence."""

    def __init__(self, sequence: BoxSequence, wish: ExportWish, camera: str, left: LeftOut) -> None:
        self._sequence, self._wish, self._left = sequence, wish, left
        self._names = namer(wish, sequence.where)
        self._small = small_ids(sequence.boxes)
        self._owner = coordinate_frame(sequence, wish.frame, camera)
        self._style = _style(sequence, wish)

    def texts(self, number: int, rows: ImageRows, rig: Rig) -> list[str]:
        """Return the rows of a frame."""
        rows, names, ignored = self._named(rows)
        if not len(rows):
            return []
        ids = np.where(ignored, -1, rows.column("track_id", -1)).tolist()
        heads = [f"{number} {self._small(id_)} {name}" for id_, name in zip(ids, names, strict=True)]
        solids = self._solids(rows, rig)
        columns = [
            heads if self._wish.is_tracking else names,
            self._states(rows, ignored, solids),
            _numbers(rows.xyxy_px, self._style.digits),
            [self._style.ignored if skip else text for skip, text in zip(ignored, self._shapes(solids), strict=True)],
        ]
        if not self._sequence.is_truth:
            scores = rows.column("score", np.nan)
            columns.append(_numbers(np.where(np.isnan(scores), _SURE, scores)[:, None], 6))
        return [" ".join(parts) for parts in zip(*columns, strict=True)]

    def _named(self, rows: ImageRows) -> tuple[ImageRows, list[str], Bool]:
        """Leave out what has no class of KITTI or no id, and tell the classes and which regions are ignored."""
        is_truth = self._sequence.is_truth
        ignored: Bool = rows.column("ignore", False) if is_truth else np.zeros(len(rows), bool)
        names = np.array([DONT_CARE if skip else "" for skip in ignored], dtype=object)
        names[~ignored] = rows[~ignored].names(self._names)
        kept: Bool = names != ""
        self._left.add("of classes that KITTI doesn't have", int(np.count_nonzero(~kept)))
        if self._wish.is_tracking:
            known = ignored | (rows.column("track_id", -1) >= 0)
            self._left.add("without a track id", int(np.count_nonzero(kept & ~known)))
            kept &= known
        return rows[kept], names[kept].tolist(), ignored[kept]

    def _solids(self, rows: ImageRows, rig: Rig) -> Float64:
        """Numbers (N, 7) of 3D boxes: height, width, length, x, y, z, rotation_y."""
        numbers = np.tile(np.array(_UNKNOWN_BOX), (len(rows), 1))
        has = rows.solid_rows >= 0
        boxes = rows.solid[rows.solid_rows[has]]
        body_T = body_T_level(self._owner, rig)
        if body_T is not None and len(boxes):
            boxes = moved(boxes, inverse(body_T))
        numbers[has] = _label_numbers(boxes)
        return numbers

    def _shapes(self, solids: Float64) -> Sequence[str]:
        return _numbers(solids, self._style.digits)

    def _states(self, rows: ImageRows, ignored: Bool, solids: Float64) -> list[str]:
        """Truncated, occluded and alpha."""
        style, is_truth = self._style, self._sequence.is_truth
        found = _numbers(_alphas(solids)[:, None], style.digits)
        if not is_truth:
            return [f"-1 -1 {alpha}" for alpha in found]
        told = [_ALPHA.fullmatch(text) for text in rows.column("attribute", "").tolist()]
        alphas = [own if match is None else match[1] for own, match in zip(found, told, strict=True)]
        truncated = [_truncated(value, self._wish.is_tracking) for value in rows.column("truncation", np.nan).tolist()]
        occluded = [round(value) if abs(value) < 1000 else -1 for value in rows.column("occlusion", np.nan).tolist()]
        return [
            f"-1 -1 {style.ignored_alpha}" if skip else f"{t} {o} {alpha}"
            for skip, t, o, alpha in zip(ignored, truncated, occluded, alphas, strict=True)
        ]


def _style(sequence: BoxSequence, wish: ExportWish) -> _Style:
    if wish.is_tracking:
        return _TRACKING
    is_own = sequence.is_truth and sequence.metadata.get("benchmark") == "object"
    return _OBJECT if is_own else replace(_OBJECT, digits=6)


def _label_numbers(boxes: Boxes3D) -> Float64:
    """Return (N, 7) from boxes at the camera with x forward, y left, z up (`boxfiles.kitti_rows.labelled`)."""
    length, width, height = boxes.size_lwh_m.T
    x, y, z = -boxes.center_m[:, 1], height / 2 - boxes.center_m[:, 2], boxes.center_m[:, 0]
    return np.stack([height, width, length, x, y, z, _wrapped(-boxes.yaw_rad - np.pi / 2)], axis=1)


def _alphas(solids: Float64) -> Float64:
    """Heading as seen from the camera (N,): rotation_y - atan2(x, z); -10 without a 3D box."""
    known = solids[:, 6] != _UNKNOWN_BOX[6]
    return np.where(known, _wrapped(solids[:, 6] - np.arctan2(solids[:, 3], solids[:, 5])), _UNKNOWN_BOX[6])


def _wrapped(angles: Float64) -> Float64:
    beyond = np.abs(angles) > np.pi + _MARGIN_RAD
    return np.where(beyond, angles - 2 * np.pi * np.round(angles / (2 * np.pi)), angles)


def _truncated(value: float, is_tracking: bool) -> str:
    if not np.isfinite(value):
        return "-1"
    return f"{value:g}" if is_tracking else f"{value:.2f}"


def _numbers(values: Float64, digits: int) -> list[str]:
    """Texts (N,) of the rows of an array."""
    form = " ".join([f"%.{digits}f"] * values.shape[1])
    texts = [form % tuple(row) for row in values.tolist()]
    return [_ZERO.sub("", text) if "-0." in text else text for text in texts]
