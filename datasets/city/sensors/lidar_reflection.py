"""How much of a LiDAR's light surfaces send back."""

import numpy as np

from fbench.datasets.city.materials import MATERIALS
from fbench.datasets.city.rays.hits import Hits
from fbench.replay.arrays import Array, Float32, Float64

_NOTHING = [0.0] * (256 - len(MATERIALS))
_DIFFUSE = np.array([material.lidar for material in MATERIALS] + _NOTHING)
_RETRO = np.array([material.retro for material in MATERIALS] + _NOTHING)


def reflectivity(hits: Hits, material: Array, direction: Float32) -> Float64:
    """Return the reflectivity (N,) in which beams of `direction` (N, 3) see what they hit; 0 where that is nothing.

    Lambert's diffuse part times the cosine of incidence, and what retroreflectors add at any angle. A white diffuse
    surface at normal incidence has 1; a sign has more, and saturates the sensor.

    Args:
        hits: of the beams.
        material: (N,) of what was hit, see `RayCaster.material`.
        direction: (N, 3) unit vectors in the world.
    """
    n, d = hits.normal, direction
    cosine = np.abs(n[:, 0] * d[:, 0] + n[:, 1] * d[:, 1] + n[:, 2] * d[:, 2]).astype(np.float64)
    return np.asarray(_DIFFUSE[material] * cosine + _RETRO[material], np.float64)
