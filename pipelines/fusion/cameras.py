"""One object that several cameras see: joining what each of them makes of it."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.pipelines.fusion.found import Found, distance_m, one_object
from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.fusion.params import FusionParams
from fbench.replay.arrays import Float64
from fbench.replay.data import VEHICLES, Source
from fbench.replay.geometry.transforms import wrap_angle

_BEARING_RAD = 0.02


@dataclass(frozen=True, eq=False)
class Placed:
    """An object and the cameras that see it."""

    found: Found
    cameras: tuple[str, ...]


def join(placed: list[Placed], found: Found, sighting: Sighting, params: FusionParams) -> list[Placed]:
    """Add an object that one camera sees, or join it with the nearest one that only other cameras saw so far.

    Cameras see the same points and much the same picture, so that they aren't independent: the better score counts.
    """
    same = [i for i, known in enumerate(placed) if _same(known, found, sighting, params)]
    if not same:
        return [*placed, Placed(found, (sighting.camera,))]
    at = min(same, key=lambda i: (distance_m(placed[i].found, found), i))
    joined = Placed(_better(placed[at].found, found), (*placed[at].cameras, sighting.camera))
    return [*placed[:at], joined, *placed[at + 1 :]]


def _same(known: Placed, found: Found, sighting: Sighting, params: FusionParams) -> bool:
    other = known.found
    if sighting.camera in known.cameras or not _alike(other.label, found.label):
        return False
    if one_object(other, found, params.merge_m):
        return True
    guessed = int(Source.C) in (other.sources, found.sources)
    return guessed and _in_line(other, found, sighting, params.gate)


def _alike(label: str, other: str) -> bool:
    return label == other or (label in VEHICLES and other in VEHICLES)


def _in_line(known: Found, found: Found, sighting: Sighting, gate: float) -> bool:
    """Tell whether two objects lie in one direction from a camera, at distances that differ by no more than guesses do.

    A camera tells directions well and distances poorly.
    """
    (near, bearing), (other, direction) = (_polar(f, sighting.eye_m) for f in (found, known))
    half_rad = float(np.min(found.size_lwh_m[:2])) / 2 / max(near, 1.0) + _BEARING_RAD
    if abs(float(wrap_angle(np.array([direction - bearing]))[0])) > half_rad:
        return False
    return abs(float(np.log(other / near))) < gate * sighting.std


def _polar(found: Found, eye_m: Float64) -> tuple[float, float]:
    x, y = found.center_m[:2] - eye_m[:2]
    return max(float(np.hypot(x, y)), 0.1), float(np.arctan2(y, x))


def _better(a: Found, b: Found) -> Found:
    """The object with the higher score, the first on ties, with the sources of both and a velocity if one has it."""
    best, other = (b, a) if b.score > a.score else (a, b)
    velocity = best.velocity_mps if np.isfinite(best.velocity_mps).all() else other.velocity_mps
    return replace(best, velocity_mps=velocity, sources=a.sources | b.sources)
