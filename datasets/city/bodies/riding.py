"""How riders sit on motorcycles and bicycles, and their helmets."""

import numpy as np

from fbench.datasets.city.bodies import pose
from fbench.datasets.city.bodies.pose import Pose
from fbench.datasets.city.bodies.shell import shell
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin
from fbench.replay.arrays import Array


def sitting(height_m: float, pelvis: Array, lean_rad: float, wrists: Array, ankles: Array, toes: Array) -> Pose:
    """Return the joints of someone who sits at `pelvis` (3,), leans forward, and holds hands and feet (2, 3) there."""
    h = height_m
    up = np.array([np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    neck = pelvis + (pose.SHOULDER - pose.HIP) * h * up
    shoulders = neck + pose.pair(0.01 * h, pose.SHOULDER_HALF * h, 0.0)
    hips = pelvis + pose.pair(0.0, pose.HIP_HALF * h, 0.0)
    knees, elbows = np.empty((2, 3)), np.empty((2, 3))
    for i, side in enumerate(pose.SIDES):
        knees[i] = pose.bent(hips[i], ankles[i], pose.THIGH * h, pose.SHANK * h, np.array([1.0, 0.25 * side, 0.3]))
        elbows[i] = pose.bent(shoulders[i], wrists[i], pose.UPPER_ARM * h, pose.FOREARM * h,
                              np.array([-0.3, 0.7 * side, -0.7]))  # fmt: skip
    head = neck + np.array([0.03 + 0.06 * np.sin(lean_rad), 0.0, 0.11]) * h
    return Pose(h, np.asarray(pelvis, np.float64), neck, head, shoulders, elbows, wrists, hips, knees, ankles, toes)


def full_helmet(at: Pose, skin: Skin, visor: Skin) -> Mesh:
    """Return a helmet that covers the whole head, with a dark visor."""
    level, half = (
        np.array([-0.085, -0.06, -0.02, 0.025, 0.062, 0.085]),
        np.array([0.045, 0.06, 0.07, 0.07, 0.053, 0.02]),
    )
    cells = np.zeros((5, 8), int)
    cells[2, [0, 1, 6, 7]] = 1
    return shell(_rings(at, level, half, 8), cells, [skin, visor])


def open_helmet(at: Pose, skin: Skin) -> Mesh:
    """Return a bicycle helmet."""
    level, half = np.array([0.02, 0.028, 0.062, 0.086]), np.array([0.05, 0.058, 0.052, 0.022])
    return shell(_rings(at, level, half, 8), np.zeros((3, 8), int), [skin])


def _rings(at: Pose, level: Array, half: Array, num: int) -> Array:
    angle = np.arange(num) * (2 * np.pi / num)
    wide = half[:, None] * at.height_m
    ring = np.stack(
        [1.15 * wide * np.cos(angle), wide * np.sin(angle), level[:, None] * at.height_m + 0 * angle], axis=2
    )
    return np.asarray(at.head + ring)
