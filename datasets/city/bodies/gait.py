"""How people walk: joint angles over one cycle of two steps."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies import pose
from fbench.datasets.city.bodies.pose import Pose
from fbench.replay.arrays import Array, Float64

NUM_PHASES: Final = 12
_FOOT_AT: Final = np.array([0, 0.12, 0.25, 0.33, 0.45, 0.55, 0.65, 0.75, 0.83, 1.0])
_FOOT_DEG: Final = np.array([0, 4.0, 28, 42, 22, 4, -4, -16, 0, 0])
"""How far a foot points down, over the cycle that begins in the middle of its stance. Angles follow the usual curves of
level walking (for example Perry, Gait Analysis), made smaller in the knee so that phase 0 serves who stands too."""


@dataclass(frozen=True)
class Walk:
    """One person's way of walking."""

    height_m: float
    stride_rad: float
    """How far the thighs swing to each side."""
    arm_rad: float
    lean_rad: float
    breadth: float
    """Width of shoulders and hips, 1 as usual."""


def walking(walk: Walk, phase: float) -> Pose:
    """Return the joints at a phase from 0 to below 1: in the middle of the left leg's stance at 0, of the right's at
    half. Heights are relative to the pelvis' usual height: the feet are nearly on the ground.
    """
    h, at = walk.height_m, np.array([phase, phase + 0.5]) % 1.0
    swing = np.sin(2 * np.pi * at)
    thigh, knee = 0.04 - walk.stride_rad * swing, _knee(at)
    hips = pose.pair(0.0, pose.HIP_HALF * walk.breadth * h, pose.HIP * h)
    knees = hips + pose.turned(thigh, pose.THIGH * h)
    ankles = knees + pose.turned(thigh - knee, pose.SHANK * h)
    down = np.radians(np.interp(at, _FOOT_AT, _FOOT_DEG))
    toes = ankles + _sole(down, h)
    pelvis = hips.mean(0)
    spine = np.array([np.sin(walk.lean_rad), 0, np.cos(walk.lean_rad)]) * (pose.SHOULDER - pose.HIP) * h
    neck = pelvis + spine
    shoulders = neck + pose.pair(walk.lean_rad - 0.02 * swing * h, pose.SHOULDER_HALF * walk.breadth * h, 0.0)
    arm = 0.02 + walk.arm_rad * swing
    elbows = shoulders + pose.turned(arm, pose.UPPER_ARM * h) + pose.pair(0.0, 0.018 * h, 0.0)
    wrists = elbows + pose.turned(arm + 0.25 + 0.25 * np.maximum(swing, 0), pose.FOREARM * h)
    head = neck + np.array([0.02 + 0.3 * walk.lean_rad, 0, 0.115]) * h
    return Pose(h, pelvis, neck, head, shoulders, elbows, wrists, hips, knees, ankles, toes)


def _knee(at: Float64) -> Float64:
    """Flexion [rad]: little in stance, most before the leg passes the other one."""
    away = np.abs((at - 0.39 + 0.5) % 1.0 - 0.5)
    bump = np.where(away < 0.2, np.cos(away / 0.2 * np.pi / 2) ** 2, 0.0)
    return np.asarray(np.radians(5 + 47 * bump), np.float64)


def _sole(down_rad: Array, height_m: float) -> Float64:
    """From ankle to the tip of the sole (N, 3), for feet that point down by angles (N,)."""
    forward, below = 0.72 * pose.FOOT * height_m, pose.ANKLE * height_m
    cos, sin = np.cos(down_rad), np.sin(down_rad)
    return np.asarray(np.column_stack([forward * cos - below * sin, 0 * cos, -forward * sin - below * cos]), np.float64)
