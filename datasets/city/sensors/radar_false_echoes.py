"""Echoes where nothing is: detours by way of other surfaces, and clutter."""

from dataclasses import replace

import numpy as np

from fbench.datasets.city.rays.hits import MISS
from fbench.datasets.city.rig import RadarSpec
from fbench.datasets.city.sensors.radar_echoes import Echoes, directions
from fbench.replay.arrays import Float64

GHOST_LOSS_DB = 10.0
_GHOST_DETOUR_M = (1.0, 10.0)
_CLUTTER_FROM_M = 1.0
_CLUTTER_DBSM = (-10.0, 5.0)
_CLUTTER_MPS = 0.5
"""All of these are chosen, not measured: what is published gives kinds of false echoes, but hardly figures."""


def ghosts(echoes: Echoes, spec: RadarSpec, rng: np.random.Generator) -> Echoes:
    """Return second echoes of road users that are strong enough for it, with the chance `spec.multipath` each.

    They come from the same direction, 1 to 10 m farther and 10 dB weaker, with once or twice the relative speed:
    reflected once more by another surface, or by the ego vehicle itself. An echo is strong where its ghost would still
    be found.
    """
    strong = echoes[(echoes.body >= 0) & (echoes.margin_db >= GHOST_LOSS_DB)]
    chance, detour, twice = rng.random((3, len(strong)))
    farther = strong.range_m + _GHOST_DETOUR_M[0] + (_GHOST_DETOUR_M[1] - _GHOST_DETOUR_M[0]) * detour
    all_ghosts = replace(
        strong,
        range_m=farther,
        speed_mps=strong.speed_mps * np.where(twice < 0.5, 1.0, 2.0),
        rcs_dbsm=strong.rcs_dbsm - GHOST_LOSS_DB,
        margin_db=strong.margin_db - GHOST_LOSS_DB,
        body=np.full(len(strong), MISS, np.int32),
        true_range_m=np.full(len(strong), np.nan),
    )
    return all_ghosts[(chance < spec.multipath) & (farther <= spec.range_m)]


def clutter(spec: RadarSpec, sensor_mps: Float64, rng: np.random.Generator) -> Echoes:
    """Return false echoes, Poisson many, evenly over the field of view, their density falling with 1 / range.

    -10 dBsm with a deviation of 5 dB, and 0.5 m/s over ground: what drops, spray and leaves do.

    Args:
        spec: The radar.
        sensor_mps: (3,) the sensor's velocity over ground, in its own axes.
        rng: Draws all chances.
    """
    num = int(rng.poisson(spec.clutter))
    share, across, up = rng.random((3, num))
    nearest = min(_CLUTTER_FROM_M, spec.range_m)
    azimuth = (across - 0.5) * np.radians(spec.horizontal_fov_deg)
    altitude = (up - 0.5) * np.radians(spec.vertical_fov_deg)
    return Echoes(
        range_m=nearest * (spec.range_m / nearest) ** share,
        azimuth_rad=azimuth,
        altitude_rad=altitude,
        speed_mps=rng.normal(0.0, _CLUTTER_MPS, num) - (directions(azimuth, altitude) * sensor_mps).sum(axis=1),
        rcs_dbsm=rng.normal(*_CLUTTER_DBSM, num),
        margin_db=np.zeros(num),
        body=np.full(num, MISS, np.int32),
        true_range_m=np.full(num, np.nan),
    )
