"""Images of the city, with the truth of every pixel."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.camera.develop import averaged, developed, jpeg
from fbench.datasets.city.camera.edges import edge_pixels, jittered
from fbench.datasets.city.camera.lamps import lamps_of
from fbench.datasets.city.camera.light import light_of
from fbench.datasets.city.camera.rain import add_streaks
from fbench.datasets.city.camera.samples import Eye, Samples, first_samples, more_samples
from fbench.datasets.city.camera.shade import Scene, radiances
from fbench.datasets.city.camera.surfaces import surfaces_of
from fbench.datasets.city.camera.wet import NOTHING, mirrored_samples, spread_mirrored
from fbench.datasets.city.instant import Instant
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import RayCaster
from fbench.datasets.city.rig import CameraSpec
from fbench.replay.arrays import Array, Float32, Int64
from fbench.replay.data import Image
from fbench.replay.draws import generator


@dataclass(frozen=True, eq=False)
class Picture:
    """One image and what each pixel shows; pixel (u, v) is at [v, u]."""

    image: Image
    """As JPEG."""
    rgb: Array
    """(H, W, 3) uint8, before it was encoded."""
    depth_m: Float32
    """(H, W) Z in camera coordinates; infinite for the sky."""
    body: Array
    """(H, W) int32 index of the actor, `STATIC` or `MISS` (the sky)."""
    material: Array
    """(H, W) uint8 index into `MATERIALS`; 255 for the sky."""
    normal: Float32
    """(H, W, 3) in the world, towards the camera; 0 for the sky."""
    alone: tuple[tuple[int, Int64], ...]
    """As `Hits.alone`, with pixels v * W + u."""


def picture(now: Instant, spec: CameraSpec) -> Picture:
    """Take an image: one ray through the centre of each pixel, more where edges need it.

    The camera's coordinates are x right, y down, z forward. The noise is its own; the rest is the same for all cameras.
    """
    light, model = light_of(now.weather), spec.model()
    caster, states, eye = now.caster, now.states, Eye(model, now.world_T_sensor)
    lamps = lamps_of(caster.actors, states, now.street_lamps_m, light)
    scene = Scene(light, surfaces_of(caster, states, light), lamps, 1 / float(model.K[0, 0]), _salt(now.seed))
    uv = eye.pixels()
    samples = first_samples(caster, states, eye, uv, light)
    width, height = spec.size_wh
    linear = _smoothed(caster, states, eye, uv, samples, scene).reshape(height, width, 3)
    add_streaks(linear, now, model, light)
    rgb = developed(linear, spec, light, now.draws("camera"))
    image = Image(now.sensor, now.stamp_ns, now.log_ns, jpeg(rgb, spec.jpeg_quality), "jpeg", spec.size_wh)
    return _with_truth(image, rgb, samples, eye.depth_m(uv, samples.hits.range_m))


def _smoothed(caster: RayCaster, states: BodyStates, eye: Eye, uv: Float32, samples: Samples, scene: Scene) -> Float32:
    """Linear light (N, 3) of all pixels, at edges averaged over several rays."""
    mirror = _mirror(caster, states, eye, samples, scene)
    linear = radiances(samples, scene, mirror)
    width = eye.model.size_wh[0]
    pixels = edge_pixels(samples, linear, width)
    if len(pixels):
        more = more_samples(caster, states, eye, jittered(uv, pixels, width), scene.light, samples, pixels)
        there = mirror[np.repeat(pixels, len(more.lit) // len(pixels))] if len(mirror) else mirror
        averaged(linear, radiances(more, scene, there), pixels)
    return linear


def _mirror(caster: RayCaster, states: BodyStates, eye: Eye, samples: Samples, scene: Scene) -> Float32:
    """What wet ground mirrors (N, 4), or nothing (0, 4) where it is dry."""
    found = mirrored_samples(caster, states, samples, eye.model.size_wh[0]) if scene.light.wet > 0 else None
    if found is None:
        return NOTHING
    seen, index = found
    return spread_mirrored(radiances(seen, scene, NOTHING), index, eye.model.size_wh)


def _with_truth(image: Image, rgb: Array, samples: Samples, depth_m: Float32) -> Picture:
    width, height = image.size_wh
    hits = samples.hits
    return Picture(
        image, rgb, depth_m.reshape(height, width), hits.body.reshape(height, width),
        samples.material.reshape(height, width), hits.normal.reshape(height, width, 3), hits.alone,
    )  # fmt: skip


def _salt(seed: int) -> int:
    return int(generator(seed, "camera", "clouds").integers(1 << 30))
