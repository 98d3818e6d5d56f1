"""Objects as a file tells them one by one, as columns: the careful way, which names the row of what is wrong."""

from collections.abc import Sequence

import numpy as np

from fbench.metrics.files.side import nothing, objects_of
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Float64, text_array
from fbench.replay.boxfiles.rows import Labelled

_NONE3 = (np.nan,) * 3
_NONE4 = (np.nan,) * 4


def columns_of(steps: Sequence[int], rows: Sequence[Labelled]) -> Objects:
    """Return labelled objects as columns; labels are the source's words in lower case.

    Args:
        steps: Frame or stamp of each row.
        rows: The objects.
    """
    if not rows:
        return nothing()
    solids = [row.solid for row in rows]
    flats = [row.flat for row in rows]
    has_solid, has_flat = any(s is not None for s in solids), any(f is not None for f in flats)
    yaws = [np.nan if s is None else s.yaw_pitch_roll_rad[0] for s in solids]
    found, _ = objects_of(
        {
            "step": np.array(steps, np.int64),
            "label": text_array([row.source_label.lower() for row in rows]),
            "track_id": np.array([-1 if row.track_id is None else row.track_id for row in rows], np.int64),
            "score": np.array([0.0 if row.score is None else row.score for row in rows]),
            "xyxy_px": np.array([_NONE4 if f is None else f.xyxy_px for f in flats]) if has_flat else None,
            "center_m": np.array([_NONE3 if s is None else s.center_m for s in solids]) if has_solid else None,
            "size_lwh_m": np.array([_NONE3 if s is None else s.size_lwh_m for s in solids]) if has_solid else None,
            "yaw_rad": np.array(yaws) if has_solid else None,
            "velocity_mps": _velocities(rows),
            "alpha_rad": _numbers([row.alpha_rad for row in rows]),
            "occlusion": _numbers([row.occlusion for row in rows]),
            "truncation": _numbers([row.truncation for row in rows]),
            "visibility": _numbers([row.visibility for row in rows]),
            "attribute": text_array([row.attribute or "" for row in rows]) if any(r.attribute for r in rows) else None,
            "num_points": _counts([row.num_lidar_pts for row in rows]),
            "ignore": _flags([row.ignore for row in rows]),
        }
    )
    return found


def _numbers(values: Sequence[float | None]) -> Float64 | None:
    if all(value is None for value in values):
        return None
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _counts(values: Sequence[int | None]) -> np.ndarray | None:
    if all(value is None for value in values):
        return None
    return np.array([-1 if value is None else value for value in values], np.int64)


def _flags(values: Sequence[bool | None]) -> np.ndarray | None:
    return np.array([bool(value) for value in values]) if any(values) else None


def _velocities(rows: Sequence[Labelled]) -> Float64 | None:
    told = [None if row.solid is None else row.solid.velocity_mps for row in rows]
    return None if all(v is None for v in told) else np.array([_NONE3 if v is None else v for v in told])
