"""Radar detection: echoes clustered by place and velocity."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.sensors.points.clustering import ClusterParams
from fbench.pipelines.sensors.points.grid import median
from fbench.pipelines.sensors.points.merged import Echoes, radar_scans
from fbench.pipelines.sensors.points.vehicle import VehicleSize
from fbench.pipelines.sensors.radar import doppler
from fbench.pipelines.sensors.radar.doppler import DopplerParams, UnmeasuredParams
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig

_ECHO_HEIGHT_M = 0.3
"""Where most echoes of a vehicle come from [m above ground]: bumpers, wheels and the gap under the floor."""
_SPREADING_FROM_M = 20.0  # See `RadarParams.full_score_within_m`; chosen on development seeds of the simulated city


@dataclass(frozen=True)
class RadarClusterParams(ClusterParams, prefix="radar.cluster"):
    """Clustering of moving echoes, over x, y and velocity."""

    eps_m: float = in_range(2.0, 0.01, 100)  # Radius [m].
    min_points: int = in_range(5, 1, 1e6)  # Echoes within the radius that make a core point, itself included.
    adaptive_from_m: float | None = None
    """Beyond this distance from the body's origin [m] the radius grows in proportion to it; none: it is the same
    everywhere."""
    seconds: float = in_range(1.0, 0, 100)
    """A difference in radial velocity of 1 m/s counts as a distance of this many meters [s]."""


OWN = ("max_range_m", "min_magnitude_db", "doppler")
"""Parameters that may differ between radars: what acts before their echoes are clustered."""


@dataclass(frozen=True)
class RadarParams(CheckedParams, prefix="radar"):
    """Parameters of detection by radar."""

    max_range_m: float = in_range(60.0, 1, 1000)  # Farthest echoes [m] that are used.
    min_magnitude_db: float = in_range(-math.inf, -math.inf, 1e6)
    """Weaker echoes [dB or dBsm, as the sensor gives it] are left out; those of unknown magnitude stay."""
    min_speed_mps: float = in_range(0.3, 0, 100)
    """Slower echoes [m/s over ground] count as stationary: radar3d finds moving objects only."""
    doppler: DopplerParams = field(default_factory=DopplerParams)  # How the ego motion is taken out of the velocities.
    cluster: RadarClusterParams = field(default_factory=RadarClusterParams)  # How echoes are grouped.
    unmeasured: UnmeasuredParams = field(default_factory=UnmeasuredParams)
    """What echoes of radars without Doppler must be like."""
    size: VehicleSize = field(default_factory=VehicleSize)  # What clusters are completed to.
    full_score_echoes: float = in_range(20.0, 0.1, 1e6)  # A cluster of n echoes scores 1 - exp(-n / this).
    full_score_within_m: float | None = in_range(None, 1, 10_000)
    """Farther away [m] each echo counts as the square of the distance over this, as rays spread; none: 20 m in
    simulated logs, whose radars spread rays evenly, else an echo counts the same at any distance."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.size.check("radar.size")


@dataclass(frozen=True, eq=False)
class RadarView:
    """What the radars see."""

    xyz: Float64  # (N, 3) [m] in body coordinates, all echoes within range
    cluster: Int64  # (N,) number of the cluster, -1: none; those numbers are rows of `boxes`
    boxes: Boxes3D  # One for each cluster, with score and velocity along the line of sight


@dataclass(frozen=True, eq=False)
class Compensated:
    """Echoes of all radars with the radars' own motion taken out."""

    xyz: Float64  # (N, 3) [m] in body coordinates
    direction: Float64  # (N, 3) unit vectors from the radar to the points, in body axes
    range_rate_mps: Float64
    """(N,) radial velocity over ground [m/s], positive when receding; NaN where the sensor gives none."""
    period_mps: Float64  # (N,) velocities alias with this period [m/s]; 0: unambiguous
    is_strong: Bool  # (N,) whether an echo is among the strongest of its scan
    own_mps: Float64
    """(N,) the radar's own velocity towards the points [m/s]: range_rate_mps less this is how fast their distance from
    it changes. NaN where velocities were recorded without the ego motion.
    """


def resolve_scoring(params: RadarParams, log_info: LogInfo) -> RadarParams:
    """Return parameters that say how echoes of this log's radars count."""
    if params.full_score_within_m is not None or SIMULATED not in log_info.metadata:
        return params
    return replace(params, full_score_within_m=_SPREADING_FROM_M)


def compensate(scans: Sequence[Echoes], own: Mapping[str, RadarParams]) -> Compensated:
    """Merge the echoes of one or several radars, whose parameters `own` holds by name, within range, and take the ego
    motion out of their velocities: each radar moves in its own way where the vehicle turns.
    """
    parts = []
    for scan in scans:
        params = own[scan.sensor]
        near = np.hypot(scan.xyz[:, 0], scan.xyz[:, 1]) < params.max_range_m
        near &= ~(scan.magnitude_db < params.min_magnitude_db)  # unknown ones are NaN, and no reason to drop an echo
        period, velocity = np.full(len(scan.xyz), scan.period_mps), doppler.own_velocity(scan, params.doppler)
        rate, direction = doppler.over_ground(scan, velocity), scan.direction[near]
        toward = direction[:, 0] * velocity[0] + direction[:, 1] * velocity[1]
        moved = np.full(len(toward), np.nan) if params.doppler.ego_motion == "removed" else toward
        is_strong = doppler.strong(scan.magnitude_db[near], params.unmeasured)
        parts.append((scan.xyz[near], direction, rate[near], period[near], is_strong, moved))
    return Compensated(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def detect(echoes: Compensated, params: RadarParams) -> RadarView:
    """Find what moves, and what may, where no velocity was measured."""
    cluster = _clusters(echoes, params)
    return RadarView(echoes.xyz, cluster, _boxes(echoes, cluster, params))


def _clusters(echoes: Compensated, params: RadarParams) -> Int64:
    """Number the clusters (N,) of echoes that move, then those of strong ones whose movement isn't known."""
    moving = np.abs(echoes.range_rate_mps) >= params.min_speed_mps
    rate = echoes.range_rate_mps[moving]
    periods = np.unique(echoes.period_mps[np.isfinite(echoes.range_rate_mps)])
    if len(periods) == 1:  # velocities of different periods can be compared only where they are smallest
        rate = _shift_seam(rate, float(periods[0]))
    features = np.column_stack([echoes.xyz[moving, :2], rate * params.cluster.seconds])
    result, grouping = np.full(len(echoes.xyz), -1), params.cluster.grouping
    result[moving] = grouping.clusters(features, np.hypot(features[:, 0], features[:, 1]))
    if np.isfinite(echoes.range_rate_mps).all():
        return result
    where = echoes.xyz, echoes.range_rate_mps
    return doppler.add_unmeasured(*where, echoes.is_strong, result, grouping, params.unmeasured)


def _shift_seam(rate_mps: Float64, period_mps: float) -> Float64:
    """Shift ambiguous velocities to [0, period), so that the seam lies at standstill, where nothing that moves is."""
    return rate_mps if period_mps <= 0 else np.asarray(np.mod(rate_mps, period_mps), np.float64)


def _boxes(echoes: Compensated, cluster: Int64, params: RadarParams) -> Boxes3D:
    size = params.size
    rows = [np.flatnonzero(cluster == number) for number in range(int(cluster.max(initial=-1)) + 1)]
    if not rows:
        return Boxes3D.empty()
    center, bearing, length = (np.array(part) for part in zip(*(_place(echoes, r, size) for r in rows), strict=True))
    rate = np.array([median_rate(echoes.range_rate_mps[r], echoes.period_mps[r]) for r in rows])
    velocity = np.column_stack([rate * np.cos(bearing), rate * np.sin(bearing), 0 * rate])
    others = np.full((len(rows), 2), (size.width_m, size.height_m))
    num, from_m = np.array([len(r) for r in rows]), params.full_score_within_m
    growth = 1.0 if from_m is None else np.maximum(1.0, np.hypot(center[:, 0], center[:, 1]) / from_m) ** 2
    score = 1 - np.exp(-num * growth / params.full_score_echoes)
    # A radar sees no heading: most traffic is parallel to the own way, and what is longer than a car was seen along it.
    yaw = np.where(length > size.length_m, bearing, 0.0)
    return Boxes3D(center, np.column_stack([length, others]), yaw, velocity_mps=velocity, score=score)


def _place(echoes: Compensated, rows: Int64, size: VehicleSize) -> tuple[Float64, float, float]:
    """Center (3,) [m], direction from the radar [rad] and length [m] of one cluster.

    The cluster's near end is the near side of the vehicle, which reaches from there along the line of sight at
    least as far as a car does on average over its headings, (length + width) / 4 to its middle. The tenths of the
    echoes that are nearest and farthest are left out.
    """
    xyz = echoes.xyz[rows]
    ray = np.median(echoes.direction[rows], axis=0)
    bearing = float(np.arctan2(ray[1], ray[0]))
    cos, sin = np.cos(bearing), np.sin(bearing)
    along = np.sort(xyz[:, 0] * cos + xyz[:, 1] * sin)
    across = np.median(xyz[:, 1] * cos - xyz[:, 0] * sin)
    near, far = along[len(along) // 10], along[-1 - len(along) // 10]
    middle = near + max((size.length_m + size.width_m) / 4, (far - near) / 2)
    center = np.array([middle * cos - across * sin, middle * sin + across * cos, np.median(xyz[:, 2])])
    center[2] += size.height_m / 2 - _ECHO_HEIGHT_M
    return center, bearing, max(size.length_m, float(far - near))


def median_rate(rate_mps: Float64, period_mps: Float64) -> float:
    """Median radial velocity [m/s] of one cluster, by the least ambiguous of the radars that see it. What is still
    ambiguous is taken to be the slower of the two.
    """
    known = np.isfinite(rate_mps)
    if not known.any():
        return math.nan
    rate_mps, period_mps = rate_mps[known], period_mps[known]
    period = 0.0 if np.any(period_mps <= 0) else float(period_mps.max())
    rate = median(_shift_seam(rate_mps[period_mps == period], period))
    return rate - period if period > 0 and rate > period / 2 else rate


class RadarStage:
    """Knows with which period each radar's velocities alias. Raises LogError where a period in the log is none."""

    def __init__(self, rig: Rig, log_info: LogInfo, params: RadarParams, settings: SensorSettings) -> None:
        self._rig, self._params = rig, resolve_scoring(params, log_info)
        self._own = {
            name: replace(own, doppler=doppler.resolve_ego_motion(name, log_info, own.doppler))
            for name, own in settings.own("radar", params, OWN).items()
        }
        self._periods = {n: doppler.velocity_period(n, log_info, own.doppler) for n, own in self._own.items()}

    def view(self, frame: Frame, clock: StageClock) -> RadarView:
        """Detect in the echoes of one frame; without radar nothing is seen."""
        return self.detect(self.echoes(frame, clock), clock)

    def detect(self, echoes: Compensated | None, clock: StageClock) -> RadarView:
        """Detect in echoes as `echoes` gives them."""
        if echoes is None:
            return RadarView(np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
        with clock.stage("detect.radar"):
            return detect(echoes, self._params)

    def echoes(self, frame: Frame, clock: StageClock) -> Compensated | None:
        """Echoes of all radars of one frame with the ego motion taken out; `None` where no radar delivered."""
        with clock.stage("calibrate"):
            scans = radar_scans(self._rig, frame, self._periods)
        if scans is None:
            return None
        with clock.stage("preprocess"):
            return compensate(scans, self._own)
