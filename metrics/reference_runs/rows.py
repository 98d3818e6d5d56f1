"""Objects with a rectangle, a solid or both, from the boxes of frames."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.reference_runs.names import Family, names_of
from fbench.metrics.reference_runs.twins import twins
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.export.image_rows import ImageRows

_ALPHA = re.compile(r"alpha=(-?[0-9]{1,4}(?:\.[0-9]{1,9})?)")
"""Attribute of 2D truth from KITTI's labels."""
_UNKNOWN_ALPHA = -10.0


@dataclass(frozen=True, eq=False)
class Rows:
    """N objects of several frames."""

    frame: Int64
    """(N,) ascending."""
    found: ImageRows
    """A rectangle is NaN where there is none."""

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Bool | Int64) -> "Rows":
        f = self.found
        return Rows(
            self.frame[rows], ImageRows(f.xyxy_px[rows], f.flat, f.flat_rows[rows], f.solid, f.solid_rows[rows])
        )

    @property
    def ignored(self) -> Bool:
        """(N,)"""
        return np.asarray(self.found.column("ignore", False), bool)


def both(flat_frame: Int64, flat: Boxes2D, chosen: Int64, solid_frame: Int64, solid: Boxes3D) -> Rows:
    """Return the objects of 2D boxes of one camera, and of 3D boxes: in each frame those with a 2D box in their order,
    then the others.

    Args:
        flat_frame: (N,) frame of each 2D box.
        flat: N of them.
        chosen: Rows of those in the camera's image.
        solid_frame: (M,)
        solid: 3D boxes.
    """
    mates = twins(flat_frame[chosen], flat[chosen], solid_frame, solid)
    alone = np.setdiff1d(np.arange(len(solid)), mates)
    frame = np.concatenate([flat_frame[chosen], solid_frame[alone]])
    xyxy = np.concatenate([flat.xyxy_px[chosen], np.full((len(alone), 4), np.nan)])
    flat_rows = np.concatenate([chosen, np.full(len(alone), -1)])
    rows = Rows(frame, ImageRows(xyxy, flat, flat_rows, solid, np.concatenate([mates, alone])))
    return rows[np.argsort(frame, kind="stable")] if (np.diff(frame) < 0).any() else rows


def concatenated(parts: Sequence[Rows]) -> Rows:
    """Join rows of the same boxes, one part after the other."""
    first = parts[0].found
    xyxy, flat_rows, solid_rows = (
        np.concatenate([getattr(part.found, name) for part in parts]) for name in ("xyxy_px", "flat_rows", "solid_rows")
    )
    frame = np.concatenate([part.frame for part in parts])
    return Rows(frame, ImageRows(xyxy, first.flat, flat_rows, first.solid, solid_rows))


def objects_of(rows: Rows, family: Family | None, step: Int64, alpha_rad: Float64 | None = None) -> Objects:
    """Return rows as objects with the benchmark's names, in their order; solids are where the 3D boxes are.

    Args:
        rows: N, sorted by step.
        family: Of the benchmark; `None`: of none.
        step: (N,) ascending.
        alpha_rad: (N,) angles of observation that follow from the boxes; those that the source tells go first.
    """
    found, ignored = rows.found, rows.ignored
    center, size, yaw = _solids(found)
    return Objects(
        step=step,
        label=names_of(family, found.column("source_label", ""), found.column("label", ""), ignored),
        track_id=_ids(rows, family),
        score=_scores(found),
        xyxy_px=_known(found.xyxy_px),
        center_m=center,
        size_lwh_m=size,
        yaw_rad=yaw,
        alpha_rad=_alphas(found, alpha_rad),
        occlusion=_numbers(found, "occlusion"),
        truncation=_numbers(found, "truncation"),
        visibility=_numbers(found, "visibility"),
        ignore=ignored if ignored.any() else None,
    )


def _ids(rows: Rows, family: Family | None) -> Int64:
    """MOTChallenge's regions have ids too, which no other box has."""
    ids = np.asarray(rows.found.column("track_id", -1), np.int64)
    if family != "mot":
        return ids
    nameless = np.flatnonzero(rows.ignored & (ids < 0))
    ids = ids.copy()
    ids[nameless] = int(ids.max(initial=-1)) + 1 + np.arange(len(nameless))
    return ids


def _scores(found: ImageRows) -> Float64:
    return np.zeros(len(found)) if _has_none(found, "score") else np.asarray(found.column("score", 0.0), np.float64)


def _has_none(found: ImageRows, name: str) -> bool:
    return getattr(found.flat, name) is None and getattr(found.solid, name) is None


def _alphas(found: ImageRows, derived: Float64 | None) -> Float64 | None:
    """As the source tells them, else as they follow from the boxes."""
    angles = np.full(len(found), np.nan) if derived is None else derived.copy()
    if not _has_none(found, "attribute"):
        texts = found.column("attribute", "")
        told = [(row, match) for row, text in enumerate(texts.tolist()) if (match := _ALPHA.fullmatch(text))]
        for row, match in told:
            alpha = float(match[1])
            angles[row] = np.nan if alpha == _UNKNOWN_ALPHA else alpha
    return _known(angles)


def _solids(found: ImageRows) -> tuple[Float64 | None, Float64 | None, Float64 | None]:
    """Centre (N, 3), size (N, 3) and yaw (N,); NaN where there is no solid, `None` where there is none at all."""
    has = found.solid_rows >= 0
    if not has.any():
        return None, None, None
    own, num = found.solid[found.solid_rows[has]], len(found)
    center, size, yaw = np.full((num, 3), np.nan), np.full((num, 3), np.nan), np.full(num, np.nan)
    center[has], size[has], yaw[has] = own.center_m, own.size_lwh_m, own.yaw_rad
    return center, size, yaw


def _numbers(found: ImageRows, name: str) -> Float64 | None:
    return _known(np.asarray(found.column(name, np.nan), np.float64))


def _known(values: Float64) -> Float64 | None:
    return None if np.isnan(values).all() else values
