"""A person's mesh, from joints, build and clothes."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.shell import shell, tube
from fbench.datasets.city.mesh import Mesh, Skin
from fbench.replay.data.arrays import Array, Float64

UPPER_ARM, FOREARM, THIGH, SHANK, FOOT = 0.186, 0.146, 0.245, 0.246, 0.152
SHOULDER_HALF, HIP_HALF, ANKLE = 0.112, 0.052, 0.039
HIP, SHOULDER = 0.53, 0.818
"""Lengths as shares of the standing height (Drillis and Contini 1966, as in Winter, Biomechanics and Motor Control of
Human Movement, fig. 4.1); the joints of shoulders and hips lie further in than its widths over all."""
SIDES: Final = np.array([1.0, -1.0])
"""Left, right along y."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the joints of one person are [m]; pairs are left, right."""

    height_m: float
    """Standing."""
    pelvis: Float64
    """(3,) between the hips."""
    neck: Float64
    """(3,) between the shoulders."""
    head: Float64
    """(3,) its middle."""
    shoulders: Float64
    elbows: Float64
    wrists: Float64
    hips: Float64
    knees: Float64
    ankles: Float64
    toes: Float64
    """(2, 3) each; the tip of the shoe's sole."""


def turned(angle_rad: Array, length_m: float) -> Float64:
    """Vectors (N, 3) of a limb that hangs down, swung forward by angles (N,)."""
    angle = np.asarray(angle_rad, np.float64)
    return np.asarray(length_m * np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)]), np.float64)


def bent(start: Array, end: Array, upper_m: float, lower_m: float, towards: Array) -> Float64:
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


_LIMB: Final = 6
_TRUNK: Final = 10
_HEAD: Final = 8


@dataclass(frozen=True)
class Looks:
    """What a person wears and is like."""

    skin: Skin
    hair: Skin
    top: Skin
    sleeve: Skin
    """Of the forearms: the top's, or bare skin."""
    legs: Skin
    shank: Skin
    """Of the lower legs: the trousers', or bare skin."""
    shoes: Skin
    girth: float = 1.0
    """Thickness of trunk and limbs, 1 as usual."""
    head: float = 1.0
    """Size of the head, 1 as usual for an adult; more for children."""
    long_hair: bool = False


def figure(at: Pose, looks: Looks, with_head: bool = True) -> list[Mesh]:
    """Return trunk, head (if nothing covers it all), arms, hands, legs and shoes."""
    parts = [_trunk(at, looks), *([_neck(at, looks), _head(at, looks)] if with_head else [])]
    for side in range(2):
        parts += [_arm(at, looks, side), _leg(at, looks, side), _shoe(at, looks, side)]
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


def _trunk(at: Pose, looks: Looks) -> Mesh:
    h, g = at.height_m, looks.girth
    wide = np.array([0.05, 0.092, 0.095, 0.08, 0.094, 0.112, 0.05]) * h
    deep = np.array([0.045, 0.064, 0.064, 0.056, 0.066, 0.056, 0.035]) * h
    share = np.array([-0.25, -0.08, 0.12, 0.4, 0.72, 0.94, 1.1])
    middles = at.pelvis + share[:, None] * (at.neck - at.pelvis)
    cells = np.array([0, 0, 1, 1, 1, 1])[:, None] + np.zeros(_TRUNK, int)
    return shell(rings(middles, wide * (0.4 + 0.6 * g), deep * g, at, _TRUNK), cells, [looks.legs, looks.top], (0, 1))


def _neck(at: Pose, looks: Looks) -> Mesh:
    base = at.neck + 0.08 * (at.head - at.neck)
    return tube([base, 0.4 * base + 0.6 * at.head], np.array([0.034, 0.03]) * at.height_m, _LIMB, [looks.skin])


def _head(at: Pose, looks: Looks) -> Mesh:
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


def _arm(at: Pose, looks: Looks, side: int) -> Mesh:
    h, g = at.height_m, 0.5 + 0.5 * looks.girth
    shoulder, elbow, wrist = at.shoulders[side], at.elbows[side], at.wrists[side]
    hand = (wrist - elbow) / (FOREARM * h)
    path = [1.08 * shoulder - 0.08 * elbow, 0.8 * shoulder + 0.2 * elbow, elbow, wrist, wrist + 0.045 * h * hand,
            wrist + 0.095 * h * hand]  # fmt: skip
    radii = np.array([0.022 * g, 0.034 * g, 0.028 * g, 0.02, 0.025, 0.013]) * h
    return tube(path, radii, _LIMB - 1, [looks.top, looks.top, looks.sleeve, looks.skin, looks.skin])


def _leg(at: Pose, looks: Looks, side: int) -> Mesh:
    h, g = at.height_m, 0.5 + 0.5 * looks.girth
    hip, knee, ankle = at.hips[side], at.knees[side], at.ankles[side]
    path = [hip, 0.5 * (hip + knee), knee, 0.65 * knee + 0.35 * ankle, ankle]
    radii = np.array([0.055 * g, 0.05 * g, 0.036 * g, 0.034 * g, 0.026]) * h
    return tube(path, radii, _LIMB, [looks.legs, looks.legs, looks.shank, looks.shank])


def _shoe(at: Pose, looks: Looks, side: int) -> Mesh:
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
