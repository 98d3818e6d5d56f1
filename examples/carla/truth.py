"""Truth of one instant: boxes in body coordinates, and what of them can be seen by depth cameras all around."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.city.rig import CameraSpec
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.geometry.transforms import inverse, transform, yaw_pitch_roll

TRUTH_RANGE_M = 120.0  # As in the simulated city


@dataclass(frozen=True, eq=False)
class Body:
    """A road user at one instant, in fbench's axes."""

    track_id: int
    label: str
    source_label: str
    world_T_box: Float64
    size_lwh_m: Float64
    velocity_mps: Float64  # (3,) over ground, in the world's axes
    is_parked: bool = False


EYE_M = (0.0, 0.0, 1.8)  # From where the depth cameras look at bodies, in body coordinates, as in the city
FACES_DEG = (0.0, 90.0, 180.0, -90.0)  # Their yaw, x forward, y left
FACE_PX = 600
_GRID = 12  # Rays across a body, in both directions
_MARGIN_M = 0.3


def face(yaw_deg: float) -> CameraSpec:
    """Return one of the four depth cameras that look all around, each over 90 by 90 degrees."""
    angles = (yaw_deg, 0.0, 0.0)
    return CameraSpec(translation_m=EYE_M, yaw_pitch_roll_deg=angles, size_wh=(FACE_PX, FACE_PX), fov_deg=90.0)


def truth(
    stamp_ns: int, bodies: Sequence[Body], world_T_body: Float64, faces: Float64, clouds: Sequence[tuple[str, Array]]
) -> Truth:
    """Return bodies within `TRUTH_RANGE_M` of the vehicle in its coordinates, those without a line of sight as ignored.

    `faces` (4, H, W) are depths [m] by the cameras of `FACES_DEG`, `clouds` kind and points (N, 3) of sensors in body
    coordinates.
    """
    body_T_world = inverse(world_T_body)
    far_m = [np.hypot(*(body.world_T_box[:2, 3] - world_T_body[:2, 3])) for body in bodies]
    near = [body for body, m in zip(bodies, far_m, strict=True) if m <= TRUTH_RANGE_M]
    body_T_box = np.array([body_T_world @ body.world_T_box for body in near]).reshape(-1, 4, 4)
    turns = [yaw_pitch_roll(Rotation.from_matrix(one[:3, :3]).as_quat()) for one in body_T_box]
    yaw, pitch, roll = np.array(turns, np.float64).reshape(-1, 3).T
    size = np.array([body.size_lwh_m for body in near], np.float64).reshape(-1, 3)
    velocity = np.array([body_T_world[:3, :3] @ body.velocity_mps for body in near], np.float64).reshape(-1, 3)
    shares = visible_shares(body_T_box, size, faces)
    hits = {
        kind: sum((count_inside(body_T_box, size, xyz) for own, xyz in clouds if own == kind), np.zeros(len(near), int))
        for kind in ("lidar", "radar")
    }
    return Truth(stamp_ns, stamp_ns, Boxes3D(
        center_m=body_T_box[:, :3, 3], size_lwh_m=size, yaw_rad=yaw, roll_rad=roll, pitch_rad=pitch,
        velocity_mps=velocity, label=np.array([body.label for body in near], np.str_),
        track_id=np.array([body.track_id for body in near], np.int64), visibility=shares,
        attribute=np.array([_attribute(body) for body in near], np.str_), num_lidar_pts=hits["lidar"],
        num_radar_pts=hits["radar"], ignore=shares == 0,
        source_label=np.array([body.source_label for body in near], np.str_),
    ))  # fmt: skip


def _attribute(body: Body) -> str:
    speed = float(np.sqrt((body.velocity_mps**2).sum()))
    return "parked" if body.is_parked else "moving" if speed > 0.1 else "stopped"


def count_inside(body_T_box: Float64, size_lwh_m: Float64, xyz: Array) -> Int64:
    """Count the points (P, 3) in each box (N,), with a margin of 0.1 m; all in body coordinates."""
    reach = size_lwh_m / 2 + 0.1
    near = [xyz[((xyz - one[:3, 3]) ** 2).sum(axis=1) < (r**2).sum()] for one, r in zip(body_T_box, reach, strict=True)]
    inside = [np.abs(transform(inverse(one), own)) <= r for one, own, r in zip(body_T_box, near, reach, strict=True)]
    return np.array([row.all(axis=1).sum() for row in inside], np.int64).reshape(-1)


def visible_shares(body_T_box: Float64, size_lwh_m: Float64, faces: Float64) -> Float64:
    """Return the visible share (N,) of boxes, 0 to 1, as the depth cameras see them: of a grid of rays through a box,
    those that end in it against those that end before it. Rays that pass the body on their way through its box count
    as neither.
    """
    shares = [_share(*pair, faces) for pair in zip(body_T_box, size_lwh_m, strict=True)]
    return np.array(shares, np.float64)


def _share(body_T_box: Float64, size: Float64, faces: Float64) -> float:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = transform(body_T_box, signs * size / 2) - EYE_M
    middle = np.arctan2(body_T_box[1, 3], body_T_box[0, 3])
    azimuth = (np.arctan2(corners[:, 1], corners[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    altitude = np.arctan2(corners[:, 2], np.hypot(corners[:, 0], corners[:, 1]))
    steps = (np.arange(_GRID) + 0.5) / _GRID
    a = middle + azimuth.min() + steps * np.ptp(azimuth)
    e = (altitude.min() + steps * np.ptp(altitude))[:, None]
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.broadcast_to(np.sin(e), (_GRID, _GRID))], axis=2)
    rays = rays.reshape(-1, 3)
    box_T_body = inverse(body_T_box)
    start = transform(box_T_body, np.array([EYE_M]))
    with np.errstate(divide="ignore", invalid="ignore"):
        slabs = (np.array([[[-1.0]], [[1.0]]]) * size / 2 - start) / (rays @ box_T_body[:3, :3].T)
        enter, leave = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
        found = ranges_m(faces, rays)
        through = (enter <= leave) & (leave > 0) & np.isfinite(found)
        before = int((through & (found < enter - _MARGIN_M)).sum())
        on_it = int((through & (found >= enter - _MARGIN_M) & (found <= leave + _MARGIN_M)).sum())
    return on_it / max(on_it + before, 1)


def ranges_m(faces: Float64, rays: Float64) -> Float64:
    """Return how far (N,) [m] the depth cameras see along unit vectors (N, 3); NaN above and below their images."""
    yaw = np.radians(FACES_DEG)
    ahead = rays[:, :1] * np.cos(yaw) + rays[:, 1:2] * np.sin(yaw)  # (N, 4)
    which = ahead.argmax(axis=1)
    depth = ahead[np.arange(len(rays)), which]
    right = rays[:, 0] * np.sin(yaw[which]) - rays[:, 1] * np.cos(yaw[which])
    px = faces.shape[1] / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = np.stack([right, -rays[:, 2]], axis=1) / depth[:, None] * px + (px - 0.5)
    inside = (np.abs(uv - (px - 0.5)) <= px).all(axis=1)
    at = np.clip(np.round(np.where(inside[:, None], uv, 0)), 0, 2 * px - 1).astype(np.int64)
    return np.where(inside, faces[which, at[:, 1], at[:, 0]] / np.maximum(depth, 1e-9), np.nan)
