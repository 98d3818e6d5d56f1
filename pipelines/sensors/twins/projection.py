"""Twin of `replay.geometry.camera.project_body` for cameras without distortion."""

import torch
from torch import Tensor

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import NEAR_M, require_projection
from fbench.replay.geometry.lenses import lens_of
from fbench.replay.geometry.transforms import inverse


def project_body(rig: Rig, name: str, xyz: Tensor) -> tuple[Tensor, Tensor]:
    """Project points (N, 3), float64, in body coordinates into a pinhole camera: pixels (N, 2), NaN nearer than
    `NEAR_M` or behind it, and depths (N,) [m]; both within a billionth of those by numpy. Raises LogError where the
    camera has no projection, or a lens that distorts.
    """
    require_projection(rig, name)
    if lens_of(rig.cameras[name]) is not None:
        raise LogError(f"camera '{name}': only cameras without distortion are projected on a GPU")
    camera_T_body = torch.from_numpy(inverse(rig.body_T_sensor(name))).to(xyz.device)
    K = torch.from_numpy(rig.cameras[name].K.copy()).to(xyz.device)
    points = xyz @ camera_T_body[:3, :3].T + camera_T_body[:3, 3]
    depth = points[:, 2]
    safe = torch.where(depth > NEAR_M, depth, torch.nan)
    u = (K[0, 0] * points[:, 0] + K[0, 1] * points[:, 1]) / safe + K[0, 2]
    return torch.stack([u, K[1, 1] * points[:, 1] / safe + K[1, 2]], 1), depth
