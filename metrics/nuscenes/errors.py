"""How far off the boxes are that match: the five errors of true positives."""

import numpy as np

from fbench.metrics.nuscenes.solids import solids
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array, Float64

ERRORS = ("ate", "ase", "aoe", "ave", "aae")
UNITS = {"ate": "m", "ase": "1", "aoe": "rad", "ave": "m/s", "aae": "1"}
UNDEFINED = {"traffic_cone": ("aoe", "ave", "aae"), "barrier": ("ave", "aae")}
"""nuscenes-devkit 1.2.0, eval/detection/evaluate.py: cones have no orientation, neither moves or has attributes."""
HALF_TURN = ("barrier",)
"""Their two ends look alike: orientation counts modulo pi."""


def match_errors(truth: Objects, estimates: Objects) -> Float64:
    """Errors (K, 5) of K pairs, in the order of `ERRORS`; NaN where a velocity or the attribute of truth is unknown.

    Source: nuscenes-devkit 1.2.0, eval/common/utils.py.
    """
    true, said = solids(truth), solids(estimates)
    half_turn = np.isin(truth.label, HALF_TURN)
    errors: Float64 = np.stack(
        [
            _norm(said.center_m[:, :2] - true.center_m[:, :2]),
            1 - _scale_iou(true.size_lwh_m, said.size_lwh_m),
            _yaw_error(true.yaw_rad, said.yaw_rad, np.where(half_turn, np.pi, 2 * np.pi)),
            _velocity_error(truth, estimates),
            _attribute_error(truth, estimates),
        ],
        axis=1,
    )
    return errors


def _norm(xy: Array) -> Float64:
    norm: Float64 = np.sqrt(xy[:, 0] ** 2 + xy[:, 1] ** 2)
    return norm


def _scale_iou(a: Array, b: Array) -> Float64:
    """Intersection over union (K,) of boxes with one centre and heading."""
    shared = np.minimum(a, b).prod(axis=1)
    iou: Float64 = shared / (a.prod(axis=1) + b.prod(axis=1) - shared)
    return iou


def _yaw_error(truth: Array, estimates: Array, period: Array) -> Float64:
    """Smallest angle (K,) between headings, modulo `period`."""
    turn = (truth - estimates + period / 2) % period - period / 2
    error: Float64 = np.abs(turn)
    return error


def _velocity_error(truth: Objects, estimates: Objects) -> Float64:
    if truth.velocity_mps is None or estimates.velocity_mps is None:
        return np.full(len(truth), np.nan)
    return _norm(estimates.velocity_mps[:, :2] - truth.velocity_mps[:, :2])


def _attribute_error(truth: Objects, estimates: Objects) -> Float64:
    if truth.attribute is None:
        return np.full(len(truth), np.nan)
    said = np.full(len(truth), "") if estimates.attribute is None else estimates.attribute
    return np.where(truth.attribute == "", np.nan, (truth.attribute != said).astype(np.float64))
