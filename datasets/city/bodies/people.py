"""People of joints, build and clothes, and adults and children who walk."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.palette import HAIR, SKINS, TOPS, TROUSERS, linear, pick
from fbench.datasets.city.bodies.shell import body, shell, tube
from fbench.datasets.city.mesh import Body, Mesh, Skin
from fbench.replay.data.arrays import Array, Float64

UPPER_ARM, FOREARM, THIGH, SHANK, FOOT = 0.186, 0.146, 0.245, 0.246, 0.152
SHOULDER_HALF, HIP_HALF, ANKLE = 0.112, 0.052, 0.039
HIP, SHOULDER = 0.53, 0.818
"""Lengths as shares of the standing height (Drillis and Contini 1966, as in Winter, Biomechanics and Motor Control of
Human Movement, fig. 4.1); the joints of shoulders and hips lie further in than its widths over all."""
SIDES: Final = np.array([1.0, -1.0])  # Left, right along y


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the joints of one person are [m]; pairs are left, right."""

    height_m: float  # Standing
    pelvis: Float64  # (3,) between the hips
    neck: Float64  # (3,) between the shoulders
    head: Float64  # (3,) its middle
    shoulders: Float64
    elbows: Float64
    wrists: Float64
    hips: Float64
    knees: Float64
    ankles: Float64
    toes: Float64  # (2, 3) each; the tip of the shoe's sole


def turn_limb(angle_rad: Array, length_m: float) -> Float64:
    """Vectors (N, 3) of a limb that hangs down, swung forward by angles (N,)."""
    angle = np.asarray(angle_rad, np.float64)
    return np.asarray(length_m * np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)]), np.float64)


def bend_limb(start: Array, end: Array, upper_m: float, lower_m: float, towards: Array) -> Float64:
    """Return where the joint (3,) between two bones lies that go from start to end, bent towards a direction (3,)."""
    line = np.asarray(end, np.float64) - start
    reach = float(np.sqrt((line * line).sum()))
    axis = line / reach
    side = np.asarray(towards, np.float64) - (axis * towards).sum() * axis
    side /= np.sqrt((side * side).sum())
    along = (upper_m**2 - lower_m**2 + reach**2) / (2 * reach)
    out = np.sqrt(max(upper_m**2 - along**2, 0.0))
    return np.asarray(start + min(along, upper_m) * axis + out * side, np.float64)


def pair(x: Array | float, y: float, z: Array | float) -> Float64:
    """Return places (2, 3) on the left and on the right."""
    return np.column_stack([np.broadcast_to(x, 2), SIDES * y, np.broadcast_to(z, 2)]).astype(np.float64)


_LIMB, _TRUNK, _HEAD = 6, 10, 8  # Sides


@dataclass(frozen=True)
class Appearance:
    """What a person wears and is like."""

    skin: Skin
    hair: Skin
    top: Skin
    sleeve: Skin  # Of the forearms: the top's, or bare skin
    legs: Skin
    shank: Skin  # Of the lower legs: the trousers', or bare skin
    shoes: Skin
    girth: float = 1.0  # Thickness of trunk and limbs, 1 as usual
    head: float = 1.0  # Size of the head, 1 as usual for an adult; more for children
    long_hair: bool = False


def figure(at: Pose, looks: Appearance, with_head: bool = True) -> list[Mesh]:
    """Return trunk, head (if nothing covers it all), arms, hands, legs and shoes."""
    h, g, limb = at.height_m, looks.girth, 0.5 + 0.5 * looks.girth
    wide = np.array([0.05, 0.092, 0.095, 0.08, 0.094, 0.112, 0.05]) * h
    deep = np.array([0.045, 0.064, 0.064, 0.056, 0.066, 0.056, 0.035]) * h
    share = np.array([-0.25, -0.08, 0.12, 0.4, 0.72, 0.94, 1.1])
    trunk = rings(at.pelvis + share[:, None] * (at.neck - at.pelvis), wide * (0.4 + 0.6 * g), deep * g, at, _TRUNK)
    cells = np.array([0, 0, 1, 1, 1, 1])[:, None] + np.zeros(_TRUNK, int)
    parts = [shell(trunk, cells, [looks.legs, looks.top], (0, 1))]
    if with_head:
        neck = at.neck + 0.08 * (at.head - at.neck)
        parts.append(tube([neck, 0.4 * neck + 0.6 * at.head], np.array([0.034, 0.03]) * h, _LIMB, [looks.skin]))
        parts.append(_head(at, looks))
    for side in range(2):
        shoulder, elbow, wrist = at.shoulders[side], at.elbows[side], at.wrists[side]
        hand = (wrist - elbow) / (FOREARM * h)
        path = [1.08 * shoulder - 0.08 * elbow, 0.8 * shoulder + 0.2 * elbow, elbow, wrist, wrist + 0.045 * h * hand,
                wrist + 0.095 * h * hand]  # fmt: skip
        radii = np.array([0.022 * limb, 0.034 * limb, 0.028 * limb, 0.02, 0.025, 0.013]) * h
        parts.append(tube(path, radii, _LIMB - 1, [looks.top, looks.top, looks.sleeve, looks.skin, looks.skin]))
        hip, knee, ankle = at.hips[side], at.knees[side], at.ankles[side]
        path = [hip, 0.5 * (hip + knee), knee, 0.65 * knee + 0.35 * ankle, ankle]
        radii = np.array([0.055 * limb, 0.05 * limb, 0.036 * limb, 0.034 * limb, 0.026]) * h
        parts.append(tube(path, radii, _LIMB, [looks.legs, looks.legs, looks.shank, looks.shank]))
        parts.append(_shoe(at, looks, side))
    return parts


def upright(at: Pose) -> tuple[Float64, Float64, Float64]:
    """Forward, left, up (3,) of the trunk."""
    up = at.neck - at.pelvis
    up = up / np.sqrt((up * up).sum())
    left = at.shoulders[0] - at.shoulders[1] + 2 * (at.hips[0] - at.hips[1])
    left = left - (left * up).sum() * up
    left = left / np.sqrt((left * left).sum())
    return np.cross(left, up), left, up


def rings(middles: Array, half_wide: Array, half_deep: Array, at: Pose, num: int) -> Float64:
    """Ellipses (S, num, 3) across the trunk around middles (S, 3)."""
    forward, left, _ = upright(at)
    angle = np.arange(num) * (2 * np.pi / num) + np.pi / num
    deep, wide = np.asarray(half_deep)[:, None, None], np.asarray(half_wide)[:, None, None]
    ring = deep * np.cos(angle)[:, None] * forward + wide * np.sin(angle)[:, None] * left
    return np.asarray(np.asarray(middles)[:, None] + ring, np.float64)


def _head(at: Pose, looks: Appearance) -> Mesh:
    """An egg whose face is in front; hair on top and behind, down to the neck where it is long."""
    h = at.height_m * looks.head
    level = np.array([-0.068, -0.052, -0.012, 0.03, 0.055, 0.068]) * h
    half = np.array([0.022, 0.036, 0.045, 0.046, 0.034, 0.012]) * h
    angle = np.arange(_HEAD) * (2 * np.pi / _HEAD) + np.pi / _HEAD
    middle = at.head + np.array([0, 0, 0.003]) * h
    shift = np.array([0.012, 0.01, 0.0, 0.0, -0.002, -0.004]) * h
    ring = np.stack([1.22 * half[:, None] * np.cos(angle) + shift[:, None], half[:, None] * np.sin(angle),
                     level[:, None] + 0 * angle], axis=2)  # fmt: skip
    behind = np.cos(angle + np.pi / _HEAD) < (0.35 if looks.long_hair else -0.2)
    cells = np.stack([behind & looks.long_hair, behind, behind, behind | True, behind | True]).astype(int)
    return shell(middle + ring, cells, [looks.skin, looks.hair], (0, 1))


def _shoe(at: Pose, looks: Appearance, side: int) -> Mesh:
    """From heel to toes, flat below: the sole runs from under the ankle to the toes."""
    h, ankle, ahead = at.height_m, at.ankles[side], at.toes[side] - at.ankles[side]
    forward, below = 0.72 * FOOT, ANKLE
    turned = np.array([-ahead[2], 0.0, ahead[0]])
    scale = (forward**2 + below**2) * h
    along, up = (forward * ahead + below * turned) / scale, (forward * turned - below * ahead) / scale
    across, above = np.array([(-0.9, 0.0), (0.9, 0.0), (1.0, 0.5), (0.5, 1.3), (-0.5, 1.3), (-1.0, 0.5)]).T
    rows = [(-0.042, 0.018, 0.7), (-0.02, 0.026, 1.0), (0.035, 0.028, 1.0), (0.085, 0.031, 0.55), (0.109, 0.02, 0.4)]
    ring = np.stack([
        ankle + h * (x * along + below * (tall * above - 1)[:, None] * up
                     + (wide * across)[:, None] * np.array([0, 1.0, 0]))
        for x, wide, tall in rows
    ])  # fmt: skip
    return shell(ring, np.zeros((len(rows) - 1, 6), int), [looks.shoes])


NUM_PHASES: Final = 12
_FOOT_AT: Final = np.array([0, 0.12, 0.25, 0.33, 0.45, 0.55, 0.65, 0.75, 0.83, 1.0])
_FOOT_DEG: Final = np.array([0, 4.0, 28, 42, 22, 4, -4, -16, 0, 0])
"""How far a foot points down, over the cycle that begins in the middle of its stance. Angles follow the usual curves of
level walking (for example Perry, Gait Analysis), made smaller in the knee so that phase 0 serves who stands too."""


@dataclass(frozen=True)
class Walk:
    """One person's way of walking."""

    height_m: float
    stride_rad: float  # How far the thighs swing to each side
    arm_rad: float
    lean_rad: float
    breadth: float  # Width of shoulders and hips, 1 as usual


def walk_pose(walk: Walk, phase: float) -> Pose:
    """Return the joints at a phase from 0 to below 1: in the middle of the left leg's stance at 0, of the right's at
    half. Heights are relative to the pelvis' usual height: the feet are nearly on the ground.
    """
    h, at = walk.height_m, np.array([phase, phase + 0.5]) % 1.0
    swing = np.sin(2 * np.pi * at)
    away = np.abs((at - 0.39 + 0.5) % 1.0 - 0.5)  # the knee bends little in stance, most before it passes the other
    knee = np.radians(5 + 47 * np.where(away < 0.2, np.cos(away / 0.2 * np.pi / 2) ** 2, 0.0))
    thigh = 0.04 - walk.stride_rad * swing
    hips = pair(0.0, HIP_HALF * walk.breadth * h, HIP * h)
    knees = hips + turn_limb(thigh, THIGH * h)
    ankles = knees + turn_limb(thigh - knee, SHANK * h)
    down = np.radians(np.interp(at, _FOOT_AT, _FOOT_DEG))
    forward, below, cos, sin = 0.72 * FOOT * h, ANKLE * h, np.cos(down), np.sin(down)
    toes = ankles + np.column_stack([forward * cos - below * sin, 0 * cos, -forward * sin - below * cos])
    pelvis = hips.mean(0)
    spine = np.array([np.sin(walk.lean_rad), 0, np.cos(walk.lean_rad)]) * (SHOULDER - HIP) * h
    neck = pelvis + spine
    shoulders = neck + pair(walk.lean_rad - 0.02 * swing * h, SHOULDER_HALF * walk.breadth * h, 0.0)
    arm = 0.02 + walk.arm_rad * swing
    elbows = shoulders + turn_limb(arm, UPPER_ARM * h) + pair(0.0, 0.018 * h, 0.0)
    wrists = elbows + turn_limb(arm + 0.25 + 0.25 * np.maximum(swing, 0), FOREARM * h)
    head = neck + np.array([0.02 + 0.3 * walk.lean_rad, 0, 0.115]) * h
    return Pose(h, pelvis, neck, head, shoulders, elbows, wrists, hips, knees, ankles, toes)


_CHILDREN: Final = 0.12  # Share of pedestrians


@dataclass(frozen=True)
class Extras:
    """What someone has besides; `None` what not."""

    hat: Skin | None
    coat: Skin | None
    hem: float  # Where coat or skirt ends: 0 at the hips, 1 at the knees
    from_chest: bool  # Whether it begins at the chest, as a coat, or at the waist, as a skirt
    backpack: Skin | None
    bag: Skin | None


def make_pedestrian(draw: np.random.Generator) -> Body:
    """Draw someone who walks: 12 phases of a cycle of two steps."""
    child = draw.random() < _CHILDREN
    height = float(draw.uniform(1.12, 1.42) if child else np.clip(draw.normal(1.70, 0.085), 1.5, 1.92))
    looks = draw_appearance(draw, 1.2 if child else 1.0)
    hat, coat, long, pack, bag = (float(draw.random()) for _ in range(5))
    cloth = Skin("cloth", pick(draw, TOPS))
    is_coat, has_pack = coat < 0.18, pack < (0.45 if child else 0.22)
    extras = Extras(
        hat=cloth if hat < 0.18 and not has_pack else None,
        coat=looks.top if is_coat else cloth if coat < 0.32 else None,
        hem=(0.35 if is_coat else 0.7) + 0.35 * long,
        from_chest=is_coat,
        backpack=Skin("cloth", pick(draw, TOPS)) if has_pack else None,
        bag=Skin("cloth", pick(draw, TROUSERS)) if bag < 0.25 and not child and not has_pack else None,
    )
    walk = Walk(height, stride_rad=float(draw.uniform(0.29, 0.36)), arm_rad=float(draw.uniform(0.15, 0.32)),
                lean_rad=float(draw.uniform(0.0, 0.06)), breadth=float(draw.uniform(0.95, 1.12)))  # fmt: skip
    poses = [walk_pose(walk, i / NUM_PHASES) for i in range(NUM_PHASES)]
    return body("pedestrian", [[*figure(at, looks), *_extras(at, looks, extras)] for at in poses])


def draw_appearance(draw: np.random.Generator, head: float = 1.0) -> Appearance:
    """Draw build, skin, hair and clothes."""
    skin, top = Skin("skin", pick(draw, SKINS)), Skin("cloth", pick(draw, TOPS))
    legs, shoes = Skin("cloth", pick(draw, TROUSERS)), Skin("rubber", linear("1c1b1b"))
    if draw.random() < 0.3:
        shoes = Skin("cloth", linear("d9d8d4"))
    bare_arms, bare_legs = draw.random() < 0.35, draw.random() < 0.15
    return Appearance(
        skin, Skin("cloth", pick(draw, HAIR)), top, skin if bare_arms else top, legs,
        skin if bare_legs else legs, shoes,
        girth=float(draw.uniform(0.95, 1.3)), head=head, long_hair=bool(draw.random() < 0.4),
    )  # fmt: skip


def _extras(at: Pose, looks: Appearance, extras: Extras) -> list[Mesh]:
    parts, h = [], at.height_m
    if extras.hat is not None:
        angle = np.arange(8) * (np.pi / 4) + np.pi / 8
        half = ((0.07, 0.024), (0.052, 0.03), (0.047, 0.062), (0.03, 0.076))
        rows = [np.column_stack([1.15 * r * np.cos(angle) + 0.004, r * np.sin(angle), np.full(8, z)]) for r, z in half]
        parts.append(shell(at.head + h * looks.head * np.stack(rows), np.zeros((3, 8), int), [extras.hat]))
    if extras.coat is not None:  # from waist or chest down over both thighs, as wide as the step
        thighs = at.hips + extras.hem * (at.knees - at.hips)
        hem, apart = thighs.mean(0), abs(thighs[0, 0] - thighs[1, 0]) / 2
        top = at.pelvis + (0.8 if extras.from_chest else 0.35) * (at.neck - at.pelvis)
        middles = np.stack([top, at.pelvis + 0.1 * (at.neck - at.pelvis), hem])
        wide = np.array([0.105 if extras.from_chest else 0.088, 0.108, 0.112]) * h * (0.4 + 0.6 * looks.girth)
        deep = np.array([0.074, 0.078, 0.066]) * h * looks.girth + np.array([0, 0, apart])
        parts.append(shell(rings(middles, wide, deep, at, 10)[::-1], np.zeros((2, 10), int), [extras.coat]))
    if extras.backpack is not None:
        forward, _, up = upright(at)
        middle = 0.35 * at.pelvis + 0.65 * at.neck - (0.055 * looks.girth + 0.045) * h * forward
        wide, deep = np.array([0.05, 0.078, 0.074, 0.035]) * h, np.array([0.04, 0.055, 0.045, 0.025]) * h
        levels = middle + 0.125 * h * np.array([-1.0, -0.8, 0.6, 1.0])[:, None] * up
        parts.append(shell(rings(levels, wide, deep, at, 6), np.zeros((3, 6), int), [extras.backpack]))
    if extras.bag is not None:  # hangs from the right hand
        hand = at.wrists[1] + np.array([0.0, 0, -0.07]) * h
        path = np.stack([hand, hand - np.array([0, 0, 0.03]) * h, hand - np.array([0, 0, 0.15]) * h])
        parts.append(tube(path, np.array([(0.008, 0.02), (0.028, 0.085), (0.036, 0.1)]) * h, 4, [extras.bag]))
    return parts
