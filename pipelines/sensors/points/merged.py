"""Points of all sensors of one kind, compensated for motion and merged in body coordinates."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from fbench.pipelines.sensors.points.grid import lexicographic_order
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, Pose, RadarScan
from fbench.replay.data.rig import Kind, LogInfo, Rig
from fbench.replay.geometry.kernels import kernel, kernel_part
from fbench.replay.geometry.transforms import transform

_SMALL = 1e-3  # Below this angle [rad] series are more exact than quotients


@kernel
def carry_points(xyz: Float64, time_s: Float64, turn_radps: Float64, speed_mps: Float64) -> Float64:
    """Move points (N, 3) [m], each in body coordinates at its time (N,), to body coordinates at time 0.

    The body turns (3,) and moves (3,) steadily in its own axes: p -> R p + V v t with W = [w]x, a = |w| t,
    R = I + sin(a) / |w| W + (1 - cos(a)) / |w|^2 W^2 and V t = t I + (1 - cos(a)) / |w|^2 W + (a - sin(a)) / |w|^3 W^2
    (exponential of a twist: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, 2.3).
    """
    result = np.empty_like(xyz)
    rate = math.sqrt(turn_radps[0] ** 2 + turn_radps[1] ** 2 + turn_radps[2] ** 2)
    move = np.zeros((3, 4))
    before = 0.0
    for i in range(len(xyz)):
        if time_s[i] == 0.0:
            result[i] = xyz[i]
            continue
        if time_s[i] != before:  # beams of one shot share it
            before = time_s[i]
            _fill(move, before, rate, turn_radps, speed_mps)
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        for axis in range(3):
            result[i, axis] = move[axis, 0] * x + move[axis, 1] * y + move[axis, 2] * z + move[axis, 3]
    return result


@kernel_part
def _fill(move: Float64, t: float, rate: float, turn: Float64, speed: Float64) -> None:
    """Write R and V v t into `move` (3, 4)."""
    a = rate * t
    if abs(a) < _SMALL:
        first, second, third = t * (1 - a * a / 6), t * t * (0.5 - a * a / 24), t**3 * (1 / 6 - a * a / 120)
    else:
        first, second = math.sin(a) / rate, 2 * (math.sin(a / 2) / rate) ** 2
        third = (a - math.sin(a)) / rate**3
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        move[axis, axis] = 1 + second * (turn[axis] ** 2 - square)
        move[axis, j] = second * turn[axis] * turn[j] - first * turn[k]
        move[axis, k] = second * turn[axis] * turn[k] + first * turn[j]
        across = turn[j] * speed[k] - turn[k] * speed[j]  # W v
        along = turn[0] * speed[0] + turn[1] * speed[1] + turn[2] * speed[2]
        move[axis, 3] = t * speed[axis] + second * across + third * (turn[axis] * along - square * speed[axis])


FROZEN = "frozen at the stamp"
"""So the metadata `lidar.NAME.motion` say that nothing moved in a sweep, or that its points are compensated."""
_MOST_BETWEEN_NS = 1_000_000_000  # Between poses farther apart the motion isn't steady
_HOLDS_NS = 500_000_000  # So long after its last pose a motion goes on
_MOST_AWAY_NS = 1_000_000_000  # Points measured farther from the frame's instant have wrong times
_MOST_MPS, _MOST_RADPS = 100.0, 5.0  # No vehicle moves faster: such poses jumped


class Deskew:
    """Moves points to the instant of their frame: by their own times where the LiDAR gives them, else by that of the
    sweep, so that LiDARs with different stamps fit together.

    The motion is that between the last two frames with a pose, taken for steady; before the second one points stay
    where they are. Things that move themselves stay smeared by their own motion.
    """

    def __init__(self, log_info: LogInfo) -> None:
        self._log_info = log_info
        self.reset()

    def reset(self) -> None:
        """Forget the poses."""
        self._pose: Pose | None = None
        self._motion: Float64 | None = None

    def note(self, pose: Pose | None, stamp_ns: int) -> None:
        """Take the pose of the next frame, at whose instant `stamp_ns` points are wanted."""
        before = self._pose
        if pose is not None and (before is None or pose.stamp_ns != before.stamp_ns):
            self._pose, self._motion = pose, None if before is None else motion(before, pose)
        if self._pose is not None and abs(stamp_ns - self._pose.stamp_ns) > _HOLDS_NS:
            self._motion = None

    def move(self, xyz: Float64, cloud: PointCloud, rows: Int64, stamp_ns: int) -> Float64:
        """Move points (N, 3) [m] in body coordinates, which are the chosen `rows` of a sweep, to `stamp_ns`."""
        is_frozen = self._log_info.metadata.get(f"lidar.{cloud.sensor}.motion") == FROZEN
        has_times = cloud.offset_ns is not None and not is_frozen
        if self._motion is None or not (has_times or cloud.stamp_ns != stamp_ns):
            return xyz
        after_ns = np.full(len(xyz), cloud.stamp_ns - stamp_ns, np.int64)
        if has_times and cloud.offset_ns is not None:
            after_ns += cloud.offset_ns[rows]
        if np.abs(after_ns).max(initial=0) > _MOST_AWAY_NS:
            return xyz
        after_s = after_ns.astype(np.float64) * 1e-9
        return carry_points(xyz, after_s, self._motion[:3], self._motion[3:])


def motion(before: Pose, after: Pose) -> Float64 | None:
    """How the body turns [rad/s] and moves [m/s], steadily, in its own axes (6,), from one pose to the next; `None`
    where they are too far apart in time, or jumped.
    """
    between_ns = after.stamp_ns - before.stamp_ns
    if not 0 < between_ns <= _MOST_BETWEEN_NS:
        return None
    poses = np.array([before.world_T_body, after.world_T_body])
    if not np.isfinite(poses).all():
        return None
    first, second = RigidTransform.from_matrix(poses)
    twist = np.asarray((first.inv() * second).as_exp_coords(), np.float64) / (between_ns * 1e-9)
    turn, speed = twist[:3], twist[3:]
    is_sane = np.sqrt((turn**2).sum()) <= _MOST_RADPS and np.sqrt((speed**2).sum()) <= _MOST_MPS
    return twist if is_sane else None


@dataclass(frozen=True, eq=False)
class Echoes:
    """Radar points; rows in lexicographic order of their coordinates."""

    xyz: Float64  # (N, 3) [m] in body coordinates
    direction: Float64  # (N, 3) unit vectors from the sensor to the points, in body axes
    radial_velocity_mps: Float64  # (N,) [m/s] as measured, positive when receding; NaN where the sensor gives none
    magnitude_db: Float64  # (N,) radar cross section or uncalibrated magnitude; NaN where the sensor gives none
    period_mps: float = 0.0  # Velocities alias with this period [m/s]; 0: unambiguous
    sensor: str = ""  # Name of the radar

    def __getitem__(self, rows: Bool) -> "Echoes":
        """Select rows by mask."""
        columns = self.xyz[rows], self.direction[rows], self.radial_velocity_mps[rows], self.magnitude_db[rows]
        return Echoes(*columns, self.period_mps, self.sensor)


@dataclass(frozen=True)
class Outline:
    """How far the own vehicle reaches from the body's origin [m]; points in it, seen from above, lie on it."""

    front_m: float = 0.0
    rear_m: float = 0.0
    side_m: float = 0.0

    def without(self, xyz: Float64) -> Bool:
        """Tell which points (N, 3) in body coordinates [m] don't lie on the own vehicle."""
        ahead, aside = xyz[:, 0], np.abs(xyz[:, 1])
        return np.asarray(~((ahead > -self.rear_m) & (ahead < self.front_m) & (aside < self.side_m)), np.bool_)


def lidar_points(
    rig: Rig, frame: Frame, ranges_m: Mapping[str, tuple[float, float]], own: Outline = Outline(),
    deskew: Deskew | None = None,
) -> Float64 | None:  # fmt: skip
    """Points (N, 3) [m] of all LiDARs in body coordinates, in lexicographic order; `None` where no LiDAR delivered.

    `ranges_m` gives for each LiDAR the least and the largest distance of points from it; those on the vehicle itself,
    which move with it, are left out, and `deskew` moves the others to the frame's instant.
    """
    clouds = [m for _, m in sorted(frame.messages.items()) if isinstance(m, PointCloud)]
    if deskew is not None:
        deskew.note(body_pose(rig, frame), frame.stamp_ns)
    if not clouds:
        return None
    parts = []
    for cloud in clouds:
        low, high = ranges_m[cloud.sensor]
        square = np.einsum("ij,ij->i", cloud.xyz, cloud.xyz)
        near = np.flatnonzero((square >= low**2) & (square <= high**2))
        # Rows of (N, 3) are taken: four times as fast as by an index in brackets.
        xyz = transform(rig.body_T_sensor(cloud.sensor), cloud.xyz.take(near, axis=0))
        others = np.flatnonzero(own.without(xyz))
        xyz, rows = xyz.take(others, axis=0), near.take(others)
        parts.append(xyz if deskew is None else deskew.move(xyz, cloud, rows, frame.stamp_ns))
    merged = np.concatenate(parts)
    return merged.take(lexicographic_order(*merged.T), axis=0)


def viewpoint(rig: Rig, kind: Kind) -> Float64:
    """Where the sensors of a kind look from, (3,) [m] in body coordinates: the middle between them."""
    places = [rig.body_T_sensor(name)[:3, 3] for name in rig.sensors(kind)]
    return np.asarray(np.mean(places, axis=0), np.float64) if places else np.zeros(3)


def radar_scans(rig: Rig, frame: Frame, periods_mps: Mapping[str, float]) -> list[Echoes] | None:
    """Echoes of each radar, whose velocities alias with `periods_mps` by name; `None` where no radar delivered."""
    result = []
    for scan in (m for _, m in sorted(frame.messages.items()) if isinstance(m, RadarScan)):
        body_T_sensor = rig.body_T_sensor(scan.sensor)
        xyz = transform(body_T_sensor, scan.xyz)
        ray = xyz - body_T_sensor[:3, 3]
        length = np.sqrt(ray[:, 0] ** 2 + ray[:, 1] ** 2 + ray[:, 2] ** 2)
        direction = ray / np.where(length > 0, length, 1.0)[:, None]
        velocity = np.full(len(xyz), np.nan) if scan.radial_velocity_mps is None else scan.radial_velocity_mps
        velocity = np.where(np.isfinite(velocity), velocity, np.nan).astype(np.float64)
        magnitude = np.full(len(xyz), np.nan) if scan.rcs_dbsm is None else scan.rcs_dbsm.astype(np.float64)
        order = lexicographic_order(*xyz.T, velocity, magnitude)
        columns = xyz.take(order, axis=0), direction.take(order, axis=0), velocity[order], magnitude[order]
        result.append(Echoes(*columns, periods_mps.get(scan.sensor, 0.0), scan.sensor))
    return result or None


def world_T_body(rig: Rig, frame: Frame) -> Float64 | None:
    """Pose (4, 4) of the body in the world; `None` where the log has none for this frame, see `body_pose`."""
    pose = body_pose(rig, frame)
    return None if pose is None else pose.world_T_body


def body_pose(rig: Rig, frame: Frame) -> Pose | None:
    """Pose of the body in the world; `None` where the log has none for this frame. Of several sources the first by name
    counts, also in frames that lack it: sources differ in their origin.
    """
    poses = sorted(name for name, m in frame.messages.items() if isinstance(m, Pose))
    if not poses or any(name < poses[0] for name in frame.missing if name not in rig.mounts):
        return None
    pose = frame.messages[poses[0]]
    return pose if isinstance(pose, Pose) else None


def require(pipeline: str, kinds: tuple[Kind, ...], rig: Rig, log_info: LogInfo, wanted: str = "") -> None:
    """Refuse rigs without sensors of these kinds. Raises LogError naming pipeline, log and the sensors there."""
    if rig.sensors(*kinds):
        return
    words = {"lidar": "a LiDAR", "radar": "a radar", "camera": "a camera"}
    wanted = wanted or " or ".join(words[kind] for kind in kinds)
    present = ", ".join(f"{kind} {name}" for name, kind in sorted(rig.kinds.items())) or "no sensors"
    raise LogError(f"log '{log_info.name}': {pipeline} needs {wanted}; the log has: {present}", "CFG001")


def report_boxes(boxes: Boxes3D, min_score: float, source: Source, labeled: bool = False) -> Boxes3D:
    """Keep boxes with at least `min_score`, highest first, with the same fields in every frame.

    Velocities are NaN where none were measured. Equal scores are ordered by place. `labeled` tells whether boxes of
    this pipeline have labels, also where there are no boxes.
    """
    num = len(boxes)
    score = np.zeros(num) if boxes.score is None else boxes.score
    full = replace(
        boxes,
        velocity_mps=np.full((num, 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps,
        label=np.zeros(0, np.str_) if labeled and not num else boxes.label,
        score=score,
        sources=np.full(num, int(source), np.uint8),
    )
    order = np.lexsort((*boxes.center_m.T[::-1], -score))
    return full[order[score[order] >= max(min_score, np.finfo(np.float64).tiny)]]
