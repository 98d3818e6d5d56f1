"""Conditions of the rig: pipelines are given another calibration than that which holds; messages stay."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.conditions import Level, Measurement, Need, Site
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import Kind, Rig
from fbench.replay.geometry.transforms import transform


class _OfRig:
    version: ClassVar[int] = 1

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return the message as it is."""
        return (message,)


class Extrinsic(_OfRig):
    """The mount of a sensor is wrong by the same rigid motion for the whole log: body_T_sensor' = body_T_sensor
    exp(xi), a rotation about an axis and a shift along a direction, both drawn evenly from the sphere.

    exp is that of SE(3) with rotation and shift apart, so that the rotation stays one (Dong et al., CVPR 2023, add
    noise to the matrix, which then is none). Levels after Yu et al. (2022), 1 to 5 degrees, and Dong et al., 4 to
    20 cm.
    """

    kinds: ClassVar[Sequence[Kind]] = ("camera", "lidar", "radar")
    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "rotated_deg": (0.25, 0.5, 1.0, 2.0, 3.0),
        "shifted_m": (0.02, 0.05, 0.1, 0.2, 0.5),
    }

    def disturb_rig(self, rig: Rig, level: Level, site: Site) -> Rig:
        """Return the rig with another mount. Raises LogError where nothing says where the sensor is."""
        if site.sensor not in rig.mounts:
            raise LogError(f"condition extrinsic can't act: nothing says where '{site.sensor}' is mounted", "COR002")
        rng, mount = site.rng("mount"), rig.mounts[site.sensor]
        axis, shift = _direction(rng, 3), _direction(rng, 3) * level["shifted_m"]
        turn = Rotation.from_rotvec(axis * np.radians(level["rotated_deg"]))
        rotation_xyzw = (Rotation.from_quat(mount.rotation_xyzw) * turn).as_quat(canonical=True)
        moved = transform(rig.body_T_sensor(site.sensor), shift[None])[0]
        changed = replace(mount, translation_m=moved, rotation_xyzw=rotation_xyzw)
        return replace(rig, mounts={**rig.mounts, site.sensor: changed})


class Intrinsic(_OfRig):
    """The camera matrix is wrong for the whole log: focal lengths f (1 + e) with the sign of e drawn, and the principal
    point off by a shift in a direction drawn evenly. Levels are fbench's own.
    """

    kinds: ClassVar[Sequence[Kind]] = ("camera",)
    needs: ClassVar[Sequence[Need]] = ("calibration",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "focal_share": (0.002, 0.005, 0.01, 0.02, 0.04),
        "center_px": (1.0, 2.0, 5.0, 10.0, 20.0),
    }

    def disturb_rig(self, rig: Rig, level: Level, site: Site) -> Rig:
        """Return the rig with another camera matrix. Raises KeyError for a camera that isn't calibrated."""
        rng, model = site.rng("lens"), rig.cameras[site.sensor]
        K = np.array(model.K)
        K[[0, 1], [0, 1]] *= 1 + level["focal_share"] * (1 if rng.random() < 0.5 else -1)
        K[:2, 2] += _direction(rng, 2) * level["center_px"]
        return replace(rig, cameras={**rig.cameras, site.sensor: replace(model, K=K)})


def _direction(rng: np.random.Generator, num: int) -> Float64:
    """Return a vector of length 1, drawn evenly."""
    vector = rng.standard_normal(num)
    return np.asarray(vector / np.sqrt((vector**2).sum()), np.float64)
