"""Motorcycles with riders."""

from dataclasses import replace
from typing import Final

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies import pose, trim
from fbench.datasets.city.bodies.figure import figure
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.paints import BLACK, CHROME, DARK, GLASS, LINE, PLATE, STEEL, linear, pick
from fbench.datasets.city.bodies.people import draw_looks
from fbench.datasets.city.bodies.riding import full_helmet, sitting
from fbench.datasets.city.bodies.shell import both, tube
from fbench.datasets.city.bodies.thin_wheels import thick_wheel
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, box

_WHEEL_M: Final = 0.315
_FRONT_M: Final = 0.72
"""Where the front wheel is; the wheelbase of 1.44 m is typical of a middle-sized motorcycle."""
_COLORS: Final = {"a3181b": 0.25, "17181b": 0.3, "1f4b9c": 0.15, "e4e4e0": 0.1, "2f6b3a": 0.1, "d9791c": 0.1}
_JACKETS: Final = {"1b1c1f": 0.6, "4b4f54": 0.15, "7d1f22": 0.1, "23365c": 0.15}
_HELMETS: Final = {"17181b": 0.35, "e4e4e0": 0.3, "a3181b": 0.15, "c9cf2a": 0.1, "24457f": 0.1}


def make_motorcycle(draw: np.random.Generator) -> Body:
    """Draw a motorcycle with its rider, some with a case behind the seat or a windshield."""
    paint = Skin("paint", pick(draw, _COLORS))
    parts = [*_rolling(), *_machine(paint), *_lamps()]
    if draw.random() < 0.35:
        parts.append(box((-0.82, 0.0, 1.0), (0.36, 0.42, 0.3), DARK))
    if draw.random() < 0.4:
        shield = np.array([(0.2, 0.02), (0.17, 0.02), (0.09, 0.015)])
        parts.append(tube([(0.58, 0, 0.98), (0.52, 0, 1.14), (0.42, 0, 1.28)], shield, 6, [GLASS]))
    return body("motorcycle", [[*parts, *_rider(draw)]])


def _rolling() -> list[Mesh]:
    """Wheels, fork, swing arm, handlebar."""
    fork = [(_FRONT_M, 0.1, _WHEEL_M), (0.42, 0.1, 1.0)]
    arm = [(-_FRONT_M, 0.11, _WHEEL_M), (-0.2, 0.1, 0.45)]
    bar = [(0.4, 0.0, 1.03), (0.38, 0.14, 1.07), (0.3, 0.3, 1.06), (0.25, 0.4, 1.04)]
    return [
        *thick_wheel(_FRONT_M, _WHEEL_M, 0.12, STEEL), *thick_wheel(-_FRONT_M, _WHEEL_M, 0.17, STEEL),
        both(tube(fork, np.array([0.028, 0.026]), 6, [CHROME])), both(tube(arm, np.array([0.022, 0.03]), 5, [STEEL])),
        both(tube(bar, np.array([0.014, 0.014, 0.018, 0.02]), 5, [STEEL, STEEL, BLACK])),
        both(box((0.34, 0.3, 1.2), (0.03, 0.13, 0.09), BLACK)),
        both(tube([(0.33, 0.26, 1.07), (0.33, 0.27, 1.17)], np.array([0.008, 0.008]), 3, [BLACK])),
    ]  # fmt: skip


def _machine(paint: Skin) -> list[Mesh]:
    """Tank, seat, engine, tail, mudguard, exhaust."""
    tank = np.array([(0.07, 0.07), (0.15, 0.13), (0.15, 0.12), (0.1, 0.08)])
    seat = np.array([(0.11, 0.06), (0.14, 0.05), (0.13, 0.05), (0.1, 0.04)])
    tail = np.array([(0.12, 0.08), (0.11, 0.07), (0.07, 0.04)])
    guard = [
        (_FRONT_M - 0.3, 0, 0.52),
        (_FRONT_M - 0.12, 0, 0.66),
        (_FRONT_M + 0.14, 0, 0.65),
        (_FRONT_M + 0.28, 0, 0.53),
    ]
    exhaust = [(0.15, -0.14, 0.3), (-0.3, -0.17, 0.28), (-0.45, -0.19, 0.36), (-0.85, -0.2, 0.48)]
    return [
        tube([(0.42, 0, 0.87), (0.28, 0, 0.9), (0.05, 0, 0.9), (-0.1, 0, 0.84)], tank, 8, [paint]),
        tube([(-0.05, 0, 0.82), (-0.25, 0, 0.8), (-0.5, 0, 0.85), (-0.72, 0, 0.89)], seat, 8, [BLACK]),
        tube([(-0.25, 0, 0.7), (-0.6, 0, 0.76), (-0.9, 0, 0.84)], tail, 6, [paint]),
        box((0.08, 0.0, 0.48), (0.42, 0.3, 0.36), STEEL), box((0.16, 0.0, 0.66), (0.3, 0.24, 0.16), DARK),
        tube([(0.36, 0, 0.8), (0.34, 0, 0.5), (0.2, 0, 0.24)], np.array([0.03, 0.04, 0.06]), 5, [DARK]),
        box((-0.18, 0.0, 0.55), (0.2, 0.26, 0.3), LINE),
        tube(guard, np.array([(0.05, 0.012), (0.075, 0.02), (0.075, 0.02), (0.05, 0.012)]), 6, [paint]),
        tube(exhaust, np.array([0.03, 0.035, 0.055, 0.06]), 6, [CHROME]),
    ]  # fmt: skip


def _lamps() -> list[Mesh]:
    """Headlight, tail and brake light, turn signals, plate."""
    rear_guard = tube([(-0.78, 0, 0.78), (-0.98, 0, 0.58)], np.array([(0.09, 0.015), (0.07, 0.015)]), 4, [BLACK])
    return [
        tube([(0.4, 0, 0.93), (0.54, 0, 0.93), (0.6, 0, 0.93)], np.array([0.07, 0.1, 0.1]), 8, [DARK]),
        tube([(0.6, 0, 0.93), (0.615, 0, 0.93)], np.array([0.09, 0.085]), 8, [trim.HEADLIGHT]),
        box((-0.9, 0.0, 0.8), (0.05, 0.16, 0.05), trim.TAILLIGHT),
        box((-0.9, 0.0, 0.85), (0.05, 0.16, 0.05), trim.BRAKELIGHT),
        both(box((0.5, 0.2, 0.9), (0.06, 0.08, 0.05), trim.TURN)),
        both(box((-0.85, 0.16, 0.78), (0.06, 0.08, 0.05), trim.TURN)),
        rear_guard, box((-0.99, 0.0, 0.66), (0.012, 0.2, 0.2), PLATE),
    ]  # fmt: skip


def _rider(draw: np.random.Generator) -> list[Mesh]:
    jacket = Skin("cloth", pick(draw, _JACKETS))
    looks = draw_looks(draw)
    looks = replace(looks, top=jacket, sleeve=jacket, shank=looks.legs, shoes=Skin("rubber", linear("17171a")),
                    girth=float(draw.uniform(1.1, 1.35)), long_hair=False)  # fmt: skip
    h = float(draw.uniform(1.66, 1.88))
    pelvis = np.array([-0.24, 0.0, 0.87 + 0.055 * h])
    ankles = pose.pair(-0.08, 0.19, 0.36)
    toes = ankles + pose.pair(0.72 * pose.FOOT * h, 0.0, -pose.ANKLE * h)
    at = sitting(h, pelvis, float(draw.uniform(0.28, 0.42)), pose.pair(0.22, 0.35, 1.09), ankles, toes)
    return [*figure(at, looks, with_head=False), full_helmet(at, Skin("paint", pick(draw, _HELMETS)), GLASS)]
