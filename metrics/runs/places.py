"""Where in the world the boxes of a run are, and in which regions of its log."""

from collections.abc import Sequence

import numpy as np

from fbench.metrics.runs.shared import once
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.errors import ConfigError
from fbench.replay.geometry.transforms import pose_matrices
from fbench.replay.names import did_you_mean
from fbench.replay.regions import Region, inside
from fbench.replay.store import Run


def has_poses(run: Run) -> bool:
    """Whether all frames of a run have a pose."""
    return bool(np.isfinite(run.poses).all())


def regions_of(run: Run) -> tuple[Region, ...]:
    """The regions of a run's log."""
    return once(run, "regions", lambda: run.manifest.log_info.regions)


def chosen_regions(run: Run, kinds: Sequence[str]) -> tuple[Region, ...]:
    """Return the regions of these kinds.

    Raises:
        ConfigError: where the log has no such kind, or no poses, so that nobody knows where boxes are in the world.
    """
    regions = regions_of(run)
    known = list(dict.fromkeys(region.kind for region in regions))
    for kind in kinds:
        if kind not in known:
            raise ConfigError(f"log '{run.manifest.log.name}' has no region '{kind}'{did_you_mean(kind, known)}")
    if not has_poses(run):
        raise ConfigError(f"log '{run.manifest.log.name}' doesn't tell where the body was, so that its regions can't "
                          "be used; score without --region")  # fmt: skip
    return tuple(region for region in regions if region.kind in kinds)


def ground_points(run: Run, frame: Int64, center_m: Float64) -> Float64:
    """Return x, y (N, 2) in the world of points (N, 3) in body coordinates [m] at frames (N,) by index; inf where a
    point isn't finite.
    """
    frames, at = np.unique(frame, return_inverse=True)
    world_T_body = _poses(run, frames)[at]
    x, y = ((world_T_body[:, axis, :3] * center_m).sum(axis=1) + world_T_body[:, axis, 3] for axis in (0, 1))
    return np.asarray(np.nan_to_num(np.column_stack([x, y]), nan=np.inf), np.float64)


def on_ground(run: Run, kinds: Sequence[str], frame: Int64, center_m: Float64) -> Bool:
    """Tell which points (N, 3), as in `ground_points`, lie in a region of these kinds.

    Raises:
        ConfigError: as `chosen_regions`.
    """
    regions = chosen_regions(run, kinds)
    return np.asarray(inside(regions, ground_points(run, frame, center_m)), bool)


def _poses(run: Run, frames: Int64) -> Float64:
    """(F, 4, 4) of these frames by index."""
    row_of = {frame.index: row for row, frame in enumerate(run.frames)}
    rows = run.poses[[row_of[index] for index in frames.tolist()]]
    return pose_matrices(rows[:, :3], rows[:, 3:])
