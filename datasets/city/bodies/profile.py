"""The shape of a vehicle's hull in figures, and its cross-sections."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.replay.arrays import Array, Float64

Knots = tuple[tuple[float, float], ...]
_LEAST_STEP_M: Final = 0.03
_ARCH_DEG: Final = np.array([0.0, 32, 68, 112, 148, 180])


@dataclass(frozen=True)
class Profile:
    """A hull; distances `s` run back from the nose [m], heights from the ground [m]."""

    length_m: float
    width_m: float
    top: Knots
    """Height of the centre line over s, from nose to tail: bonnet, windscreen, roof, rear window, boot."""
    belt: Knots
    """Height of the windows' lower edge over s; follows the top where that is lower."""
    plan: Knots
    """Share of the width over s: rounded corners."""
    sill_m: float
    """Ground clearance."""
    mid_m: float
    """Height where it is widest."""
    tumblehome: float
    """How far the sides lean in above the belt, per metre of height."""
    windscreen: tuple[float, float]
    """From s to s, where the top is glass."""
    rear_window: tuple[float, float]
    windows: tuple[tuple[float, float], ...]
    """From s to s, where the sides are glass; pillars lie between them."""
    axles: tuple[float, ...]
    """s of the wheels' middles that have arches."""
    wheel_radius_m: float
    crown_m: float = 0.045
    """How much higher the middle is than the edges."""
    rail_m: float = 0.07
    """Height of the frame above the side windows."""
    pillar_m: float = 0.07
    """Width of the frame beside the windscreen."""
    arch_m: float = 0.055
    """Gap between tyre and arch."""


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections at stations from tail to nose."""

    s_m: Float64
    """(S,) falling."""
    half_m: Float64
    """(S, 7, 2) y and z of the left half: sill, widest, belt, window's top, roof's edge, pillar's edge, middle."""


def sections(profile: Profile) -> Sections:
    """Cut the hull wherever its outline bends."""
    s = _stations(profile)[::-1]
    half = profile.width_m / 2 * _at(profile.plan, s)
    top, bottom = _at(profile.top, s), _bottom(profile, s)
    edge = top - profile.crown_m
    arched = bottom > profile.sill_m + 0.02
    belt = np.minimum(_at(profile.belt, s), edge - 0.03)
    mid = np.minimum(np.maximum(profile.mid_m, bottom + 0.06), belt - 0.05)
    share = np.clip((edge - belt) / 0.35, 0.15, 1)
    window = edge - profile.rail_m * share * np.minimum(1.0, (edge - belt) / (2 * profile.rail_m * share))
    side = half - 0.035
    inner = side - profile.tumblehome * (edge - belt) - 0.035
    rows = [
        (half - np.where(arched, 0.0, 0.035), np.minimum(bottom, mid - 0.03)), (half, mid), (side, belt),
        (side - profile.tumblehome * (window - belt) - 0.006, window), (inner, edge),
        (inner - profile.pillar_m, edge + 0.6 * profile.crown_m), (0 * s, top),
    ]  # fmt: skip
    return Sections(s, np.stack([np.column_stack(row) for row in rows], axis=1))


def _at(knots: Knots, s: Array) -> Float64:
    s_knots, values = np.array(knots).T
    return np.asarray(np.interp(s, s_knots, values), np.float64)


def _bottom(profile: Profile, s: Float64) -> Float64:
    """Lower edge: the sill, or the arches above the wheels."""
    radius = profile.wheel_radius_m + profile.arch_m
    bottom = np.full(len(s), profile.sill_m)
    for axle in profile.axles:
        inside = radius**2 - (s - axle) ** 2
        arch = np.where(inside > 1e-6, profile.wheel_radius_m + np.sqrt(np.maximum(inside, 0)), 0)
        bottom = np.maximum(bottom, arch)
    return bottom


def _stations(profile: Profile) -> Float64:
    radius = profile.wheel_radius_m + profile.arch_m
    arches = [axle + radius * np.cos(np.radians(_ARCH_DEG)) for axle in profile.axles]
    knots = [s for s, _ in profile.top]
    edges = [s for pair in (profile.windscreen, profile.rear_window, *profile.windows) for s in pair]
    every = np.sort(np.concatenate([np.array(knots + edges), *arches]))
    every = every[(every > _LEAST_STEP_M) & (every < profile.length_m - _LEAST_STEP_M)]
    every = every[np.concatenate([[True], np.diff(every) > _LEAST_STEP_M])]
    return np.array([0.0, *every, profile.length_m])
