"""LiDAR in fog, rain and snow, and above wet ground: what beams receive, and a recorded cloud as it would be."""

from dataclasses import replace

import numpy as np

from fbench.replay.conditions.lidar.echoes import SCATTERED, WEAKEST, fog_echoes, particle_echoes, power_floor
from fbench.replay.conditions.lidar.ground import find_ground, wet_share
from fbench.replay.conditions.points import keep_points
from fbench.replay.conditions.weather import Weather, extinction_per_m, fog_extinction_per_m, fog_of, particles_of
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.arrays import Array, Bool, Float32, Float64
from fbench.replay.data.messages import PointCloud
from fbench.replay.geometry.transforms import transform

FAINTEST = 1 / 255  # Intensity below which the fog's echo goes unnoticed (Hahner et al. 2021: one step of 8 bits).
REFLECTIVITY = 0.3  # Of all targets, where a cloud has no intensity: between asphalt's 0.15 and car paint's 0.5
_FULL_SCALES = (1.0, 255.0, 65535.0)
_FLOOR_SHARE = 0.002  # Of a cloud's points that are no stronger than the weakest that the sensor finds


def receive(
    range_m: Float64, reflectivity: Float64, weather: Weather, floor: float, rng: np.random.Generator
) -> tuple[Float64, Float64, Bool]:
    """Return the strongest echoes (N,) of beams to targets at `range_m` (N,) of `reflectivity` (N,); both as for those
    without target: infinite and 0. `floor` is the weakest power that is received, in reflectivity / m^2.

    Ranges are infinite where nothing comes back; then follow received powers, corrected for range (reflectivity times
    exp(-2 extinction range), not clipped), and whether an echo is that of fog, a drop or a flake before the target.

    Power is reflectivity exp(-2 extinction range) / range^2. Where fog answers more strongly than the target, which
    depends on the distance alone in Hahner's model, its echo is received instead. The model relates the fog's echo to
    the target's, so a beam without a target has none.
    """
    extinction, particles = extinction_per_m(weather), particles_of(weather)
    if particles:  # by LISA's model echoes are lost, come from particles, and are noisy where they are weak
        equal_range_m = float(np.sqrt(WEAKEST / floor))
        echoes = particle_echoes(particles, extinction, range_m, reflectivity, rng, equal_range_m)
        received_m = np.where(np.isfinite(echoes.range_m), echoes.range_m, 0.0)
        at_m, intensity = echoes.range_m, echoes.power * received_m * received_m
        is_scattered = echoes.label == SCATTERED
    else:
        intensity = -2 * extinction * range_m  # in place from here on: large arrays are slow to get
        np.exp(intensity, out=intensity)
        intensity *= reflectivity
        needed = floor * range_m
        needed *= range_m
        received = intensity >= needed
        at_m, is_scattered = np.where(received, range_m, np.inf), np.zeros(len(range_m), bool)
        intensity *= received
    fog = fog_of(weather)
    drowned = np.flatnonzero(np.isfinite(range_m) & (range_m > fog.switch_m) & ~is_scattered)
    if len(drowned):
        if particles:
            at_m, intensity, is_scattered = at_m.copy(), intensity.copy(), is_scattered.copy()
        soft = fog_echoes(fog, range_m[drowned], rng)
        strength = reflectivity[drowned] * soft.strength
        noticed = strength >= FAINTEST
        at_m[drowned] = np.where(noticed, soft.range_m, np.inf)
        intensity[drowned] = strength * noticed
        is_scattered[drowned] = noticed
    return at_m, intensity, is_scattered


def disturb_cloud(cloud: PointCloud, weather: Weather, site: Site) -> PointCloud:
    """Return the cloud as it would be in a weather, had it been recorded in clear air, above dry ground.

    Every point is a beam whose target reflects as its intensity says; those of beams that met nothing weren't recorded
    and stay away. Echoes that are lost are removed, those of fog, drops and flakes lie on the beam before the target.

    Intensities count as corrected for range. Their full scale is the first of 1, 255 and 65535 that no point of the
    cloud exceeds; without any, all targets have 0.3. The weakest power that the sensor finds is that which 0.2 % of the
    cloud's points don't reach, at most LISA's, 90 % at 200 m: whatever was recorded was found in clear air.
    """
    extinction = fog_extinction_per_m(Weather())  # of clear air, which has been at work on what was recorded
    has_air = extinction_per_m(weather) > extinction
    range_m = _ranges(cloud.xyz)
    is_beam = np.isfinite(range_m) & (range_m > 0)
    if not is_beam.any() or not (has_air or weather.water_mm > 0):
        return cloud
    beams: Array | slice = slice(None) if is_beam.all() else np.flatnonzero(is_beam)
    range_m = range_m[beams]
    scale, reflectivity = _reflectivity(cloud, beams)
    reflectivity *= np.exp(2 * extinction * range_m)
    floor = _power_floor(range_m, reflectivity)
    if weather.water_mm > 0:
        body_T_sensor = site.rig.body_T_sensor(cloud.sensor)
        ground = find_ground(transform(body_T_sensor, cloud.xyz[beams]), body_T_sensor[:3, 3])
        rows = np.zeros(0, np.int64) if ground is None else ground.rows
        if ground is not None:
            reflectivity[rows] *= wet_share(weather.water_mm, ground.cos_incidence)
        if not has_air:
            beams, range_m, reflectivity = np.flatnonzero(is_beam)[rows], range_m[rows], reflectivity[rows]
    at_m, power, is_scattered = receive(range_m, reflectivity, weather, floor, site.rng_of(cloud, "air"))
    is_received = np.isfinite(at_m)
    moved = np.flatnonzero((at_m != range_m) & is_received)
    xyz, intensity, keep = cloud.xyz, cloud.intensity, np.ones(len(cloud.xyz), bool)
    keep[beams] = is_received
    if len(moved):
        xyz = xyz.copy()
        points = xyz[beams]
        points[moved] *= (np.maximum(at_m[moved], 0.0) / range_m[moved])[:, None]
        xyz[beams] = points
    if intensity is not None:
        intensity = intensity.copy()
        own = intensity[beams]
        power *= scale
        np.minimum(power, scale, out=power)
        np.copyto(own, power, where=(own > 0) | is_scattered, casting="same_kind")
        intensity[beams] = own
    return keep_points(replace(cloud, xyz=xyz, intensity=intensity), keep)


def _ranges(xyz: Float32) -> Float64:
    """Distances (N,) from the sensor, by two arrays only."""
    result, part = xyz[:, 0].astype(np.float64), xyz[:, 1].astype(np.float64)
    result *= result
    for axis in (1, 2):
        part[:] = xyz[:, axis]
        part *= part
        result += part
    return np.sqrt(result, out=result)


def _reflectivity(cloud: PointCloud, beams: Array | slice) -> tuple[float, Float64]:
    """Return the intensity's full scale and the reflectivities (M,) of beams, at least half a step of 8 bits."""
    intensity = cloud.intensity
    if intensity is None:
        return 1.0, np.full(len(cloud.xyz), REFLECTIVITY)[beams]
    largest = float(np.nanmax(intensity, initial=0.0))
    scale = next((full for full in _FULL_SCALES if largest <= full), largest)
    result: Float64 = intensity[beams].astype(np.float64)
    result /= scale
    return scale, np.fmax(result, FAINTEST / 2, out=result)


def _power_floor(range_m: Float64, reflectivity: Float64) -> float:
    """Return the weakest power that the sensor finds, by all echoes (N,) of a cloud in clear air."""
    power, at = reflectivity / range_m, int(len(range_m) * _FLOOR_SHARE)
    power /= range_m
    power.partition(at)
    return min(power_floor(), float(power[at]))
