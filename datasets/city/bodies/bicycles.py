"""Bicycles with riders who pedal."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies import pose, trim
from fbench.datasets.city.bodies.figure import Looks, figure
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.paints import BLACK, CHROME, TOPS, pick
from fbench.datasets.city.bodies.people import draw_looks
from fbench.datasets.city.bodies.riding import open_helmet, sitting
from fbench.datasets.city.bodies.shell import both, tube
from fbench.datasets.city.bodies.thin_wheels import thin_wheel
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, box
from fbench.replay.arrays import Float64

NUM_PHASES: Final = 8
_WHEEL_M: Final = 0.345
_BASE_M: Final = 1.06
_CRANK: Final = np.array([-0.09, 0.0, 0.28])
_CRANK_M: Final = 0.17
_BAR: Final = np.array([0.33, 0.0, 1.05])
"""700C wheels, a wheelbase and cranks as usual; x from the middle between the wheels."""


@dataclass(frozen=True)
class Rider:
    """Who rides and how."""

    height_m: float
    looks: Looks
    lean_rad: float
    helmet: Skin | None


def make_bicycle(draw: np.random.Generator) -> Body:
    """Draw a bicycle with its rider: 8 phases of one turn of the pedals."""
    paint = Skin("paint", pick(draw, TOPS))
    looks = replace(draw_looks(draw), girth=float(draw.uniform(0.95, 1.2)))
    helmet = Skin("plastic", pick(draw, TOPS)) if draw.random() < 0.5 else None
    rider = Rider(float(draw.uniform(1.6, 1.88)), looks, float(draw.uniform(0.4, 0.6)), helmet)
    frame = _frame(_pelvis(rider.height_m), paint)
    phases = [[*frame, *_drive(i / NUM_PHASES), *_rider(rider, i / NUM_PHASES)] for i in range(NUM_PHASES)]
    return body("bicycle", phases)


def _pelvis(height_m: float) -> Float64:
    """Where the legs nearly reach the lower pedal."""
    leg = 0.965 * (pose.THIGH + pose.SHANK) * height_m
    back = 0.2
    ankle = _CRANK + np.array([-0.06, 0, -_CRANK_M + pose.ANKLE * height_m + 0.03])
    return np.asarray(ankle + np.array([-back, 0, np.sqrt(leg**2 - back**2)]), np.float64)


def _pedals(phase: float) -> Float64:
    """Middles of the pedals (2, 3): the left one is in front at 0 and goes down."""
    angle = np.array([np.pi / 2, -np.pi / 2]) + 2 * np.pi * phase
    return _CRANK + _CRANK_M * np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)]) + pose.pair(0.0, 0.12, 0.0)


def _frame(pelvis: Float64, paint: Skin) -> list[Mesh]:
    saddle = pelvis - np.array([0.02, 0, 0.1])
    rear, front = np.array([-_BASE_M / 2, 0, _WHEEL_M]), np.array([_BASE_M / 2, 0, _WHEEL_M])
    seat, head, low = _CRANK + 0.72 * (saddle - _CRANK), np.array([0.31, 0, 0.86]), np.array([0.35, 0, 0.72])
    wide = np.array([0, 0.055, 0])
    bars = [(seat, head, 0.016), (_CRANK, low, 0.019), (_CRANK, saddle, 0.016), (head, low, 0.02)]
    forks = [(rear + wide, _CRANK + 0.5 * wide, 0.01), (rear + wide, seat, 0.009), (front + wide, low, 0.012)]
    bar = _BAR + np.array([(-0.05, 0, 0), (0.01, 0.08, 0.02), (0, 0.2, 0.02), (-0.1, 0.29, 0)])
    return [
        tube([(0.31, 0, 0.94), (0.37, 0, 0.95)], np.array([0.008, 0.008]), 3, [BLACK]),
        *thin_wheel(float(rear[0]), _WHEEL_M, 0.04, CHROME), *thin_wheel(float(front[0]), _WHEEL_M, 0.04, CHROME),
        *(tube([a, b], np.array([r, r]), 5, [paint]) for a, b, r in bars),
        *(both(tube([a, b], np.array([r, r]), 4, [paint])) for a, b, r in forks),
        tube([head, _BAR - (0.05, 0, 0)], np.array([0.016, 0.014]), 5, [CHROME]),
        both(tube(bar, np.array([0.014, 0.014, 0.014, 0.017]), 5, [CHROME, CHROME, BLACK])),
        tube(saddle + np.array([(-0.15, 0, 0), (0, 0, 0), (0.13, 0, -0.01)]),
             np.array([(0.085, 0.03), (0.06, 0.028), (0.02, 0.018)]), 6, [BLACK]),
        box((0.39, 0.0, 0.95), (0.06, 0.06, 0.06), trim.HEADLIGHT),
        box((-0.46, 0.0, 0.75), (0.03, 0.07, 0.05), trim.TAILLIGHT),
        box((-0.46, 0.0, 0.69), (0.03, 0.07, 0.04), trim.BRAKELIGHT),
    ]  # fmt: skip


def _drive(phase: float) -> list[Mesh]:
    parts = [tube([_CRANK - (0, 0.06, 0), _CRANK - (0, 0.05, 0)], np.array([0.09, 0.09]), 12, [CHROME])]
    for pedal, side in zip(_pedals(phase), pose.SIDES, strict=True):
        start, end = _CRANK + np.array([0, 0.07 * side, 0]), pedal - np.array([0, 0.05 * side, 0])
        x, y, z = (float(v) for v in pedal)
        parts += [tube([start, end], np.array([0.014, 0.012]), 4, [CHROME]), box((x, y, z), (0.09, 0.1, 0.02), BLACK)]
    return parts


def _rider(rider: Rider, phase: float) -> list[Mesh]:
    h, pedals = rider.height_m, _pedals(phase)
    pelvis = _pelvis(h)
    ankles = pedals + pose.pair(-0.06, 0.0, pose.ANKLE * h + 0.015)
    toes = ankles + pose.pair(0.72 * pose.FOOT * h, 0.0, -pose.ANKLE * h)
    wrists = _BAR + pose.pair(-0.11, 0.25, 0.035)
    at = sitting(h, pelvis, rider.lean_rad, wrists, ankles, toes)
    parts = figure(at, rider.looks)
    return [*parts, open_helmet(at, rider.helmet)] if rider.helmet is not None else parts
