"""Bicycles and motorcycles with their riders."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from fbench.datasets.city.bodies import people
from fbench.datasets.city.bodies.hull import BRAKELIGHT, HEADLIGHT, TAILLIGHT, TURN
from fbench.datasets.city.bodies.palette import BLACK, CHROME, DARK, GLASS, LINE, PLATE, STEEL, TOPS, TYRE, linear, pick
from fbench.datasets.city.bodies.people import ANKLE, FOOT, SHANK, SIDES, THIGH, Pose, pair
from fbench.datasets.city.bodies.shell import body, both, shell, tube
from fbench.datasets.city.mesh import Body, Mesh, Skin, box
from fbench.replay.data.arrays import Array, Float64


def sit_pose(height_m: float, pelvis: Array, lean_rad: float, wrists: Array, ankles: Array, toes: Array) -> Pose:
    """Return the joints of someone who sits at `pelvis` (3,), leans forward, and holds hands and feet (2, 3) there."""
    h = height_m
    up = np.array([np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    neck = pelvis + (people.SHOULDER - people.HIP) * h * up
    shoulders = neck + pair(0.01 * h, people.SHOULDER_HALF * h, 0.0)
    hips = pelvis + pair(0.0, people.HIP_HALF * h, 0.0)
    upper, lower, knees, elbows = people.UPPER_ARM * h, people.FOREARM * h, np.empty((2, 3)), np.empty((2, 3))
    for i, side in enumerate(SIDES):
        knees[i] = people.bend_limb(hips[i], ankles[i], THIGH * h, SHANK * h, np.array([1.0, 0.25 * side, 0.3]))
        elbows[i] = people.bend_limb(shoulders[i], wrists[i], upper, lower, np.array([-0.3, 0.7 * side, -0.7]))
    head = neck + np.array([0.03 + 0.06 * np.sin(lean_rad), 0.0, 0.11]) * h
    return Pose(h, np.asarray(pelvis, np.float64), neck, head, shoulders, elbows, wrists, hips, knees, ankles, toes)


def full_helmet(at: Pose, skin: Skin, visor: Skin) -> Mesh:
    """Return a helmet that covers the whole head, with a dark visor."""
    cells = np.zeros((5, 8), int)
    cells[2, [0, 1, 6, 7]] = 1
    return _helmet(at, (-0.085, -0.06, -0.02, 0.025, 0.062, 0.085), (0.045, 0.06, 0.07, 0.07, 0.053, 0.02), cells,
                   [skin, visor])  # fmt: skip


def open_helmet(at: Pose, skin: Skin) -> Mesh:
    """Return a bicycle helmet."""
    return _helmet(at, (0.02, 0.028, 0.062, 0.086), (0.05, 0.058, 0.052, 0.022), np.zeros((3, 8), int), [skin])


def _helmet(at: Pose, levels: Sequence[float], halves: Sequence[float], cells: Array, skins: list[Skin]) -> Mesh:
    angle, level = np.arange(8) * (2 * np.pi / 8), np.array(levels)[:, None] * at.height_m + 0 * np.arange(8)
    wide = np.array(halves)[:, None] * at.height_m
    ring = np.stack([1.15 * wide * np.cos(angle), wide * np.sin(angle), level], axis=2)
    return shell(np.asarray(at.head + ring), cells, skins)


def thin_wheel(x_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return a bicycle's wheel at `x_m`, with spokes; half of the ring's depth is rubber."""
    half, depth = width_m / 2, 1.8 * width_m
    rows = [(radius_m, 0.0), (radius_m - 0.5 * depth, half), (radius_m - depth, 0), (radius_m - 0.5 * depth, -half),
            (radius_m, 0.0)]  # fmt: skip
    return _wheel(x_m, radius_m, rows, (0, 1, 1, 0), 18, (4, radius_m - depth, 0.005), rim)


def thick_wheel(x_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return a motorcycle's wheel at `x_m`, with a cast rim."""
    half, inner = width_m / 2, 0.62 * radius_m
    rows = [(radius_m, 0.45 * half), (0.82 * radius_m, half), (inner, 0.0), (0.82 * radius_m, -half),
            (radius_m, -0.45 * half), (radius_m, 0.45 * half)]  # fmt: skip
    return _wheel(x_m, radius_m, rows, (0, 1, 1, 0, 0), 14, (3, inner + 0.01, 0.022), rim)


def _wheel(
    x: float, radius: float, rows: Sequence[tuple[float, float]], skins: Sequence[int], num: int,
    spokes: tuple[int, float, float], rim: Skin,
) -> list[Mesh]:  # fmt: skip
    """Turn an outline of radii and y about the axle, `skins` 0 tire, 1 rim; with bars through the hub: their number,
    reach and radius.
    """
    angle = np.arange(num) * (2 * np.pi / num) - np.pi / 2
    rings = np.stack([np.column_stack([x - r * np.cos(angle), np.full(num, y), radius + r * np.sin(angle)])
                      for r, y in rows])  # fmt: skip
    middle, (num_bars, reach, thick) = np.array([x, 0.0, radius]), spokes
    parts = [shell(rings, np.array(skins)[:, None] + np.zeros(num, int), [TYRE, rim], None),
             tube([(x, -0.05, radius), (x, 0.05, radius)], np.array([0.03, 0.03]), 6, [rim])]  # fmt: skip
    for turn in (np.arange(num_bars) + 0.5) * np.pi / num_bars:
        step = reach * np.array([np.cos(turn), 0.0, np.sin(turn)])
        parts.append(tube([middle - step, middle + step], np.array([thick, thick]), 4, [rim]))
    return parts


NUM_PHASES: Final = 8
_WHEEL_M, _BASE_M, _CRANK_M = 0.345, 1.06, 0.17
_CRANK, _BAR = np.array([-0.09, 0.0, 0.28]), np.array([0.33, 0.0, 1.05])
"""700C wheels, a wheelbase and cranks as usual; x from the middle between the wheels."""


def make_bicycle(draw: np.random.Generator) -> Body:
    """Draw a bicycle with its rider: 8 phases of one turn of the pedals."""
    paint = Skin("paint", pick(draw, TOPS))
    looks = replace(people.draw_appearance(draw), girth=float(draw.uniform(0.95, 1.2)))
    helmet = Skin("plastic", pick(draw, TOPS)) if draw.random() < 0.5 else None
    h, lean_rad = float(draw.uniform(1.6, 1.88)), float(draw.uniform(0.4, 0.6))
    leg, back = 0.965 * (THIGH + SHANK) * h, 0.2  # the legs nearly reach the lower pedal
    lowest = _CRANK + np.array([-0.06, 0, -_CRANK_M + ANKLE * h + 0.03])
    pelvis = lowest + np.array([-back, 0, np.sqrt(leg**2 - back**2)])
    frame, wrists, phases = _frame(pelvis, paint), _BAR + pair(-0.11, 0.25, 0.035), []
    for i in range(NUM_PHASES):
        angle = np.array([np.pi / 2, -np.pi / 2]) + 2 * np.pi * (i / NUM_PHASES)  # the left is in front at 0, goes down
        pedals = _CRANK + _CRANK_M * np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)]) + pair(0.0, 0.12, 0.0)
        ankles = pedals + pair(-0.06, 0.0, ANKLE * h + 0.015)
        toes = ankles + pair(0.72 * FOOT * h, 0.0, -ANKLE * h)
        at = sit_pose(h, pelvis, lean_rad, wrists, ankles, toes)
        rider = [*people.figure(at, looks), *([open_helmet(at, helmet)] if helmet is not None else [])]
        phases.append([*frame, *_drive(pedals), *rider])
    return body("bicycle", phases)


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
        box((0.39, 0.0, 0.95), (0.06, 0.06, 0.06), HEADLIGHT),
        box((-0.46, 0.0, 0.75), (0.03, 0.07, 0.05), TAILLIGHT),
        box((-0.46, 0.0, 0.69), (0.03, 0.07, 0.04), BRAKELIGHT),
    ]  # fmt: skip


def _drive(pedals: Float64) -> list[Mesh]:
    parts = [tube([_CRANK - (0, 0.06, 0), _CRANK - (0, 0.05, 0)], np.array([0.09, 0.09]), 12, [CHROME])]
    for pedal, side in zip(pedals, SIDES, strict=True):
        start, end = _CRANK + np.array([0, 0.07 * side, 0]), pedal - np.array([0, 0.05 * side, 0])
        x, y, z = (float(v) for v in pedal)
        parts += [tube([start, end], np.array([0.014, 0.012]), 4, [CHROME]), box((x, y, z), (0.09, 0.1, 0.02), BLACK)]
    return parts


_MOTOR_WHEEL_M: Final = 0.315
_FRONT_M: Final = 0.72  # Where the front wheel is; the wheelbase of 1.44 m is typical of a middle-sized motorcycle
_COLORS: Final = {"a3181b": 0.25, "17181b": 0.3, "1f4b9c": 0.15, "e4e4e0": 0.1, "2f6b3a": 0.1, "d9791c": 0.1}
_JACKETS: Final = {"1b1c1f": 0.6, "4b4f54": 0.15, "7d1f22": 0.1, "23365c": 0.15}
_HELMETS: Final = {"17181b": 0.35, "e4e4e0": 0.3, "a3181b": 0.15, "c9cf2a": 0.1, "24457f": 0.1}


def make_motorcycle(draw: np.random.Generator) -> Body:
    """Draw a motorcycle with its rider, some with a case behind the seat or a windshield."""
    parts = _machine(Skin("paint", pick(draw, _COLORS)))
    if draw.random() < 0.35:
        parts.append(box((-0.82, 0.0, 1.0), (0.36, 0.42, 0.3), DARK))
    if draw.random() < 0.4:
        shield = np.array([(0.2, 0.02), (0.17, 0.02), (0.09, 0.015)])
        parts.append(tube([(0.58, 0, 0.98), (0.52, 0, 1.14), (0.42, 0, 1.28)], shield, 6, [GLASS]))
    jacket = Skin("cloth", pick(draw, _JACKETS))
    looks = people.draw_appearance(draw)
    looks = replace(looks, top=jacket, sleeve=jacket, shank=looks.legs, shoes=Skin("rubber", linear("17171a")),
                    girth=float(draw.uniform(1.1, 1.35)), long_hair=False)  # fmt: skip
    h = float(draw.uniform(1.66, 1.88))
    ankles = pair(-0.08, 0.19, 0.36)
    toes = ankles + pair(0.72 * FOOT * h, 0.0, -ANKLE * h)
    pelvis, wrists = np.array([-0.24, 0.0, 0.87 + 0.055 * h]), pair(0.22, 0.35, 1.09)
    at = sit_pose(h, pelvis, float(draw.uniform(0.28, 0.42)), wrists, ankles, toes)
    helmet = full_helmet(at, Skin("paint", pick(draw, _HELMETS)), GLASS)
    return body("motorcycle", [[*parts, *people.figure(at, looks, with_head=False), helmet]])


def _machine(paint: Skin) -> list[Mesh]:
    """Wheels, fork, swing arm, handlebar; tank, seat, engine, tail, mudguard, exhaust; lamps, turn signals, plate."""
    fork = [(_FRONT_M, 0.1, _MOTOR_WHEEL_M), (0.42, 0.1, 1.0)]
    arm = [(-_FRONT_M, 0.11, _MOTOR_WHEEL_M), (-0.2, 0.1, 0.45)]
    bar = [(0.4, 0.0, 1.03), (0.38, 0.14, 1.07), (0.3, 0.3, 1.06), (0.25, 0.4, 1.04)]
    tank = np.array([(0.07, 0.07), (0.15, 0.13), (0.15, 0.12), (0.1, 0.08)])
    seat = np.array([(0.11, 0.06), (0.14, 0.05), (0.13, 0.05), (0.1, 0.04)])
    tail = np.array([(0.12, 0.08), (0.11, 0.07), (0.07, 0.04)])
    guard = [(_FRONT_M + x, 0, z) for x, z in ((-0.3, 0.52), (-0.12, 0.66), (0.14, 0.65), (0.28, 0.53))]
    exhaust = [(0.15, -0.14, 0.3), (-0.3, -0.17, 0.28), (-0.45, -0.19, 0.36), (-0.85, -0.2, 0.48)]
    return [
        *thick_wheel(_FRONT_M, _MOTOR_WHEEL_M, 0.12, STEEL), *thick_wheel(-_FRONT_M, _MOTOR_WHEEL_M, 0.17, STEEL),
        both(tube(fork, np.array([0.028, 0.026]), 6, [CHROME])), both(tube(arm, np.array([0.022, 0.03]), 5, [STEEL])),
        both(tube(bar, np.array([0.014, 0.014, 0.018, 0.02]), 5, [STEEL, STEEL, BLACK])),
        both(box((0.34, 0.3, 1.2), (0.03, 0.13, 0.09), BLACK)),
        both(tube([(0.33, 0.26, 1.07), (0.33, 0.27, 1.17)], np.array([0.008, 0.008]), 3, [BLACK])),
        tube([(0.42, 0, 0.87), (0.28, 0, 0.9), (0.05, 0, 0.9), (-0.1, 0, 0.84)], tank, 8, [paint]),
        tube([(-0.05, 0, 0.82), (-0.25, 0, 0.8), (-0.5, 0, 0.85), (-0.72, 0, 0.89)], seat, 8, [BLACK]),
        tube([(-0.25, 0, 0.7), (-0.6, 0, 0.76), (-0.9, 0, 0.84)], tail, 6, [paint]),
        box((0.08, 0.0, 0.48), (0.42, 0.3, 0.36), STEEL), box((0.16, 0.0, 0.66), (0.3, 0.24, 0.16), DARK),
        tube([(0.36, 0, 0.8), (0.34, 0, 0.5), (0.2, 0, 0.24)], np.array([0.03, 0.04, 0.06]), 5, [DARK]),
        box((-0.18, 0.0, 0.55), (0.2, 0.26, 0.3), LINE),
        tube(guard, np.array([(0.05, 0.012), (0.075, 0.02), (0.075, 0.02), (0.05, 0.012)]), 6, [paint]),
        tube(exhaust, np.array([0.03, 0.035, 0.055, 0.06]), 6, [CHROME]),
        tube([(0.4, 0, 0.93), (0.54, 0, 0.93), (0.6, 0, 0.93)], np.array([0.07, 0.1, 0.1]), 8, [DARK]),
        tube([(0.6, 0, 0.93), (0.615, 0, 0.93)], np.array([0.09, 0.085]), 8, [HEADLIGHT]),
        box((-0.9, 0.0, 0.8), (0.05, 0.16, 0.05), TAILLIGHT), box((-0.9, 0.0, 0.85), (0.05, 0.16, 0.05), BRAKELIGHT),
        both(box((0.5, 0.2, 0.9), (0.06, 0.08, 0.05), TURN)), both(box((-0.85, 0.16, 0.78), (0.06, 0.08, 0.05), TURN)),
        tube([(-0.78, 0, 0.78), (-0.98, 0, 0.58)], np.array([(0.09, 0.015), (0.07, 0.015)]), 4, [BLACK]),
        box((-0.99, 0.0, 0.66), (0.012, 0.2, 0.2), PLATE),
    ]  # fmt: skip
