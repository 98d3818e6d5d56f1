"""How strongly surfaces send radar waves back."""

import numpy as np

from fbench.datasets.city.materials import MATERIALS
from fbench.replay.arrays import Array, Float64

_SIGMA = np.array([10 ** (material.radar_db / 10) for material in MATERIALS])
_LOBE_RAD = np.radians([material.radar_lobe_deg for material in MATERIALS])
ROUGH = 0.4
"""Share of what comes back at normal incidence that is sent evenly into all directions: by edges, gaps, grain."""
BODY_DB = 6.0
"""What road users send back beyond their outer surface: by way of wheel arches, underbodies, mirrors, limbs. With both,
a car has some 10 dBsm, a truck 20, a pedestrian -5, as at 77 GHz usual, and varies by 5 dB with its aspect."""
BEAM_SR = np.radians(0.6) ** 2
"""What the sensor's beam covers: its echo decides whether a surface is found, however many rays sample the beam."""
FAINTEST_DBSM = -7.0
"""The weakest target that is found at the radar's range in clear air."""


def sigma0_db(material: Array, body: Array, cos_incidence: Float64) -> Float64:
    """Return the cross-section per area of surface (N,) [dB m2/m2].

    Both the lobe of smooth surfaces, a Gaussian whose half width the material says, and the even share follow the
    cosine of incidence, since the wave sees only the projected surface.

    Args:
        material: (N,) indices into `MATERIALS`.
        body: (N,) index of the actor, below 0 for what stands.
        cos_incidence: (N,) cosine of the angle between ray and normal, above 0.
    """
    angle = np.arccos(np.minimum(cos_incidence, 1)) / _LOBE_RAD[material]
    lobe = (1 - ROUGH) * np.exp(-np.log(2) * angle * angle) + ROUGH
    strength: Float64 = 10 * np.log10(_SIGMA[material] * lobe * cos_incidence) + np.where(body >= 0, BODY_DB, 0.0)
    return strength


def footprint_m2(range_m: Float64, cos_incidence: Float64, solid_angle_sr: Float64) -> Float64:
    """Return the surface (N,) that rays of a solid angle (N,) light up."""
    area: Float64 = solid_angle_sr * range_m * range_m / cos_incidence
    return area


def margin_db(beam_rcs_dbsm: Float64, range_m: Float64, radar_range_m: float) -> Float64:
    """Return how far echoes (N,) are above the weakest that is found: received power falls with the range's 4th power.

    At a range of 100 m cars are found throughout, walls as far where they face the sensor, asphalt to some 15 m.

    Args:
        beam_rcs_dbsm: (N,) cross-section of what fills the beam, less what the air takes.
        range_m: (N,) of the surfaces.
        radar_range_m: how far the radar reaches.
    """
    margin: Float64 = beam_rcs_dbsm - 40 * np.log10(range_m / radar_range_m) - FAINTEST_DBSM
    return margin
