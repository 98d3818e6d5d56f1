"""What a radar can tell apart: noise, the steps in which it gives values, and echoes that fall into one cell."""

from dataclasses import replace

import numpy as np

from fbench.datasets.city.rig import RadarSpec
from fbench.datasets.city.sensors.radar_echoes import Echoes
from fbench.replay.arrays import Float64


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
