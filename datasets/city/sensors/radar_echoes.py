"""Echoes of one radar scan: reflection by surfaces, noise and resolution."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from fbench.datasets.city.mesh import MATERIALS
from fbench.datasets.city.rig import RadarSpec
from fbench.replay.data.arrays import Array, Float64, freeze_fields


@dataclass(frozen=True, eq=False)
class Echoes:
    """K echoes, in polar coordinates of the sensor: azimuth from x towards y, altitude from there towards z."""

    range_m: Float64
    azimuth_rad: Float64
    altitude_rad: Float64
    speed_mps: Float64
    """(K,) along the ray, positive when receding, relative to the sensor."""
    rcs_dbsm: Float64
    """(K,) what the sensor takes for the radar cross-section: lower by what the air took."""
    margin_db: Float64
    """(K,) how far the echo is above the weakest that the sensor finds."""
    body: Array
    """(K,) int32 index of the actor, `STATIC`, or `MISS` of echoes where nothing is."""
    true_range_m: Float64
    """(K,) of the surface, NaN where nothing is."""

    def __post_init__(self) -> None:
        one = ("f8", ("K",))
        freeze_fields(
            self, range_m=one, azimuth_rad=one, altitude_rad=one, speed_mps=one, rcs_dbsm=one, margin_db=one,
            body=("i4", ("K",)), true_range_m=one,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.range_m)

    def __getitem__(self, rows: Array) -> Self:
        """Select echoes by mask or index array."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))


def joined(parts: Sequence[Echoes]) -> Echoes:
    """Join echoes, in their order."""
    return Echoes(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Echoes)))


def directions(azimuth_rad: Float64, altitude_rad: Float64) -> Float64:
    """Return unit vectors (K, 3) in the sensor's axes: cos phi cos theta, cos phi sin theta, sin phi."""
    flat = np.cos(altitude_rad)
    return np.stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(altitude_rad)], axis=1)


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


def noisy(echoes: Echoes, spec: RadarSpec, normals: Float64) -> Echoes:
    """Return echoes as they are measured.

    Args:
        echoes: K echoes.
        spec: The radar.
        normals: (4, K) standard normal numbers: of range, azimuth, altitude, speed.
    """
    return replace(
        echoes,
        range_m=np.maximum(echoes.range_m + spec.range_noise_m * normals[0], 0.0),
        azimuth_rad=echoes.azimuth_rad + np.radians(spec.azimuth_noise_deg) * normals[1],
        altitude_rad=echoes.altitude_rad + np.radians(spec.altitude_noise_deg) * normals[2],
        speed_mps=echoes.speed_mps + spec.speed_noise_mps * normals[3],
    )


def stepped(echoes: Echoes, spec: RadarSpec) -> Echoes:
    """Return echoes whose range, direction and speed are multiples of the sensor's resolution, where it has one."""
    return replace(
        echoes,
        range_m=_rounded(echoes.range_m, spec.range_resolution_m),
        azimuth_rad=_rounded(echoes.azimuth_rad, np.radians(spec.azimuth_resolution_deg)),
        altitude_rad=_rounded(echoes.altitude_rad, np.radians(spec.altitude_resolution_deg)),
        speed_mps=_rounded(echoes.speed_mps, spec.speed_resolution_mps),
    )


def _rounded(value: Float64, step: float) -> Float64:
    return np.round(value / step) * step if step > 0 else value


def merged_cells(echoes: Echoes) -> Echoes:
    """Return one echo for all of equal range, direction and speed: powers add up, the rest is that of the strongest.

    Sorted by range, azimuth, altitude, speed.
    """
    cells = (echoes.range_m, echoes.azimuth_rad, echoes.altitude_rad, echoes.speed_mps)
    order = np.lexsort((-echoes.rcs_dbsm, *cells[::-1]))
    ordered = echoes[order]
    differs = np.zeros(len(echoes), bool)
    differs[:1] = True
    for value in cells:
        differs[1:] |= value[order][1:] != value[order][:-1]
    first = np.flatnonzero(differs)
    if not len(first):
        return ordered
    power = np.add.reduceat(10 ** (ordered.rcs_dbsm / 10), first)
    return replace(ordered[first], rcs_dbsm=10 * np.log10(power))
