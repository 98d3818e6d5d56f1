"""Objects with a rectangle, a solid or both, from the boxes of frames, by the tables by which boxes are exported."""

from typing import Any

import numpy as np

from fbench.metrics.runs.columns import count_points
from fbench.replay.contracts.profiles import Family
from fbench.replay.data.arrays import Bool, Float64, Int64, Text, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.sequences import Objects
from fbench.replay.formats.export_request import TABLES
from fbench.replay.formats.kitti import ALPHA, UNKNOWN_ALPHA
from fbench.replay.formats.sequence import ImageRows, pair_boxes

RACK = "static_object.bicycle_rack"  # nuScenes' truth tells where bicycles stand that don't count
_REGIONS = {"kitti-tracking": "dontcare", "mot": "distractor"}
"""What truth that is to be ignored is called, where a flag doesn't do."""


def names_of(family: Family | None, source_labels: Text, labels: Text, ignored: Bool) -> Text:
    """Return the benchmark's name (N,) of each box in lower case; empty where it has none, or the box has no class.

    `family` is that of the benchmark; `None`: the source's own words, else fbench's. `source_labels` (N,) are classes
    as the source names them, empty where it doesn't, `labels` (N,) those of fbench, `ignored` (N,) truth that is
    neither a hit nor a miss.
    """
    if not len(labels):
        return np.zeros(0, "U1")
    if family is None:
        return text_array([own.lower() or label for own, label in zip(source_labels, labels, strict=True)])
    table, region, known = TABLES[family], _REGIONS.get(family, ""), {}
    triples = list(zip(source_labels.tolist(), labels.tolist(), ignored.tolist(), strict=True))
    for triple in dict.fromkeys(triples):
        own, label, is_ignored = triple
        known[triple] = own if own == RACK else (table.name(own, label) or "").lower()
        # A word of MOTChallenge says by itself whether it excuses what is found there; KITTI has one for all.
        if is_ignored and region and (region == "dontcare" or own not in table.own):
            known[triple] = region
    return text_array([known[triple] for triple in triples])


def join_sides(flat_frame: Int64, flat: Boxes2D, chosen: Int64, solid_frame: Int64, solid: Boxes3D) -> ImageRows:
    """Return the objects of N 2D boxes, of which those `chosen` are in one camera's image, and of M 3D boxes, by their
    frames (N,) and (M,): in each frame those with a 2D box in their order, then the others.
    """
    mates = pair_boxes(flat[chosen], solid, flat_frame[chosen], solid_frame)
    alone = np.setdiff1d(np.arange(len(solid)), mates)
    frame = np.concatenate([flat_frame[chosen], solid_frame[alone]])
    xyxy = np.concatenate([flat.xyxy_px[chosen], np.full((len(alone), 4), np.nan)])
    flat_rows = np.concatenate([chosen, np.full(len(alone), -1)])
    rows = ImageRows(frame, xyxy, flat, flat_rows, solid, np.concatenate([mates, alone]))
    return rows[np.argsort(frame, kind="stable")] if (np.diff(frame) < 0).any() else rows


def objects_of(found: ImageRows, family: Family | None, step: Int64, alpha_rad: Float64 | None = None) -> Objects:
    """Return N rows, sorted by step (N,), as objects with the benchmark's names; solids are where the 3D boxes are.

    `family` is that of the benchmark; `None`: of none. `alpha_rad` (N,) are angles of observation that follow from the
    boxes; those that the source tells go first.
    """
    ignored, num = np.asarray(found.column("ignore", False), bool), len(found)
    ids = np.array(found.column("track_id", -1), np.int64)
    if family == "mot":  # its regions have ids, too, which no other box has
        nameless = np.flatnonzero(ignored & (ids < 0))
        ids[nameless] = int(ids.max(initial=-1)) + 1 + np.arange(len(nameless))

    has = found.solid_rows >= 0
    solid = found.solid[found.solid_rows[has]]
    center, size, yaw = np.full((num, 3), np.nan), np.full((num, 3), np.nan), np.full(num, np.nan)
    center[has], size[has], yaw[has] = solid.center_m, solid.size_lwh_m, solid.yaw_rad
    points, of_solids = np.full(num, -1), count_points(solid)
    points[has] = -1 if of_solids is None else of_solids

    alpha = np.full(num, np.nan) if alpha_rad is None else alpha_rad.copy()
    for row, text in enumerate(found.column("attribute", "").tolist()):
        if given := ALPHA.fullmatch(text):
            alpha[row] = np.nan if float(given[1]) == UNKNOWN_ALPHA else float(given[1])

    names = ("occlusion", "truncation", "visibility")
    levels: dict[str, Any] = {name: _if_known(np.asarray(found.column(name, np.nan), np.float64)) for name in names}
    return Objects(
        step=step,
        label=names_of(family, found.column("source_label", ""), found.column("label", ""), ignored),
        track_id=ids,
        score=np.asarray(found.column("score", 0.0), np.float64),
        xyxy_px=_if_known(found.xyxy_px),
        center_m=center if has.any() else None,
        size_lwh_m=size if has.any() else None,
        yaw_rad=yaw if has.any() else None,
        alpha_rad=_if_known(alpha),
        ignore=ignored if ignored.any() else None,
        num_points=points if (points >= 0).any() else None,
        **levels,
    )


def _if_known(values: Float64) -> Float64 | None:
    return None if np.isnan(values).all() else values
