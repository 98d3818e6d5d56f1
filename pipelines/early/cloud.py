"""One cloud of what stands on the ground, as LiDAR, radar and stereo see it."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import Obstacles
from fbench.pipelines.points.radar import Compensated
from fbench.replay.arrays import Array, Bool, Float64
from fbench.replay.data import Source


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of all sensors in body coordinates: LiDAR, then stereo, then radar, each in its own canonical order."""

    xyz: Float64
    """(N, 3) [m]."""
    source: Array
    """(N,) uint8 bits of `Source`: which sensor saw the point."""
    range_rate_mps: Float64
    """(N,) radial velocity over ground [m/s], positive when receding; NaN where nothing measured it."""
    period_mps: Float64
    """(N,) velocities alias with this period [m/s]; 0: unambiguous."""
    is_moving: Bool
    """(N,) whether a radar saw it move."""
    height_m: Float64
    """(N,) above the ground [m], 0 where that isn't known."""

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True)
class EchoParams:
    """Which standing radar echoes join the cloud."""

    least_height_m: float = 0.3
    """Standing echoes lower than this above the ground [m] are left out, where the ground is known."""
    most_height_m: float = 3.5
    """Standing echoes higher than this above the ground [m] are left out, where the ground is known."""

    def __post_init__(self) -> None:
        require_ranges("fusion.echoes", self, dict.fromkeys(("least_height_m", "most_height_m"), (-1000.0, 1000.0)))


def merged(
    lidar: Obstacles,
    stereo: Obstacles,
    echoes: Compensated | None,
    plane: Plane | None,
    min_speed_mps: float,
    params: EchoParams,
) -> Cloud:
    """Merge what LiDAR and stereo see stand on the ground with radar echoes, in body coordinates.

    Echoes slower than `min_speed_mps` over ground stand, and so do those whose velocity isn't known; of the latter only
    the strongest of a scan are used.
    """
    dense = np.concatenate([lidar.xyz, stereo.xyz])
    source = np.repeat(np.array([int(Source.L), int(Source.S)], np.uint8), [len(lidar.xyz), len(stereo.xyz)])
    height = np.concatenate([lidar.height_m, stereo.height_m])
    unknown, zero = np.full(len(dense), np.nan), np.zeros(len(dense))
    if echoes is None:
        return Cloud(dense, source, unknown, zero, np.zeros(len(dense), np.bool_), height)
    above = np.zeros(len(echoes.xyz)) if plane is None else echoes.xyz[:, 2] - plane.z_m(echoes.xyz)
    moving = np.abs(echoes.range_rate_mps) >= min_speed_mps
    rows = moving | _may_stand(echoes, above, plane is not None, params)
    num = int(np.count_nonzero(rows))
    return Cloud(
        np.concatenate([dense, echoes.xyz[rows]]),
        np.concatenate([source, np.full(num, int(Source.R), np.uint8)]),
        np.concatenate([unknown, echoes.range_rate_mps[rows]]),
        np.concatenate([zero, echoes.period_mps[rows]]),
        np.concatenate([np.zeros(len(dense), np.bool_), moving[rows]]),
        np.concatenate([height, above[rows]]),
    )


def _may_stand(echoes: Compensated, above_m: Float64, is_known: bool, params: EchoParams) -> Bool:
    """Tell which standing echoes (N,) may be of objects; radar is poor at heights."""
    kept = np.isfinite(echoes.range_rate_mps) | echoes.is_strong
    if not is_known:
        return kept
    return np.asarray(kept & (above_m > params.least_height_m) & (above_m < params.most_height_m), np.bool_)
