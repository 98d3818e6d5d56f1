"""Summaries of imports, and sensors from the matrices that datasets publish."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import Kind, Mount
from fbench.replay.geometry.transforms import quaternion


def listed(things: Iterable[object], most: int) -> str:
    """Return things with commas between, the first ones of many: `1, 2 and 3 more`."""
    texts = [str(thing) for thing in things]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def runs(numbers: Iterable[int]) -> list[range]:
    """Return the runs of numbers, which ascend."""
    found: list[range] = []
    for number in numbers:
        if found and number == found[-1].stop:
            found[-1] = range(found[-1].start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


def listed_runs(found: Iterable[range], most: int) -> str:
    """Return runs by their first and last numbers: `3, 177 to 180 and 2 more`."""
    return listed((f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in found), most)


def counted(counts: Counter[str]) -> str:
    """Return counts by name, the largest first, equal ones by name: `Car 3, Van 1`."""
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {num}" for name, num in ranked)


BODY_T_OPTICAL: Float64 = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from axes right, down, forward, as cameras have them, to those of bodies: forward, left, up."""


def mount_of(kind: Kind, body_T_sensor: Float64) -> Mount:
    """Return where a sensor is, by its pose (4, 4), whose rotation is made orthonormal."""
    return Mount(kind, body_T_sensor[:3, 3], quaternion(body_T_sensor[:3, :3]))


def is_rotation(R: Float64, tolerance: float = 1e-3) -> bool:
    """Tell whether a matrix (3, 3) is orthonormal up to a tolerance, as files round, and doesn't mirror."""
    # Not by BLAS, whose result depends on the machine; NaN isn't within the tolerance.
    with np.errstate(over="ignore", invalid="ignore"):
        gram = (R[:, :, None] * R[:, None, :]).sum(axis=0)
    return bool(np.abs(gram - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0)


def is_pinhole(K: Float64) -> bool:
    """Tell whether a matrix (3, 3) is of the form fx s cx / 0 fy cy / 0 0 1, with fx and fy above 0."""
    return bool(K[0, 0] > 0 and K[1, 1] > 0 and K[2, 2] == 1 and not np.tril(K, -1).any())
