"""Parts of a sequence: what is seen, by distance, by visibility, by the sensors that found something."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Bool, Float64
from fbench.replay.data import Source

RANGES_M = (0.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0)
VISIBILITIES = (0.0, 0.4, 0.6, 0.8, 1.0)
"""The steps that nuScenes labels."""
VISIBILITY_SLICES = tuple(
    f"visibility {100 * low:.0f}-{100 * high:.0f} %" for low, high in itertools.pairwise(VISIBILITIES)
)
_SENSORS = {Source.C: "camera", Source.L: "lidar", Source.R: "radar", Source.S: "stereo"}


@dataclass(frozen=True, eq=False)
class Part:
    """What of a sequence a slice is about: N truth boxes and M estimates.

    The rest of truth is neither to be found nor forbidden, and the rest of the estimates neither hits by right nor
    false alarms, as outside of the region of interest. Of these, those that aren't valid aren't there at all.
    """

    name: str
    truth: Bool
    """(N,)"""
    estimates: Bool
    """(M,)"""
    given: Bool | None = None
    """(M,) false for estimates that aren't there at all; `None`: all are."""


def by_seen(sequence: Sequence) -> Iterator[Part]:
    """Yield what some sensor of the log sees, where truth tells."""
    if sequence.truth.seen is not None:
        yield Part("seen", sequence.truth.seen, np.ones(len(sequence.estimates), bool))


def by_range(sequence: Sequence, range_m: float) -> Iterator[Part]:
    """Yield the sequence by distance in the ground plane, as far as `range_m`."""
    truth, estimates = _range(sequence.truth), _range(sequence.estimates)
    if truth is None or estimates is None:
        return
    edges = [edge for edge in RANGES_M if edge < range_m] + [min(range_m, RANGES_M[-1])]
    for low, high in itertools.pairwise(dict.fromkeys(edges)):
        # The region's own border belongs to it.
        parts = ((low <= d) & ((d < high) | ((d == high) & (high == range_m))) for d in (truth, estimates))
        yield Part(f"range {low:g}-{high:g} m", *parts)


def by_visibility(sequence: Sequence) -> Iterator[Part]:
    """Yield the sequence by the visible share of truth. What isn't there has no visibility: no false alarms here."""
    visible = sequence.truth.visibility
    if visible is None or not np.isfinite(visible).any():
        return
    nothing = np.zeros(len(sequence.estimates), bool)
    for name, (low, high) in zip(VISIBILITY_SLICES, itertools.pairwise(VISIBILITIES), strict=True):
        part = (low <= visible) & ((visible < high) | (high == VISIBILITIES[-1]))
        yield Part(name, part, nothing)


def by_source(sequence: Sequence) -> Iterator[Part]:
    """Yield what each kind of sensor had a part in, alone or with others, against all of truth."""
    sources = sequence.estimates.sources
    if sources is None:
        return
    every = np.ones(len(sequence.truth), bool), np.ones(len(sources), bool)
    for source, name in _SENSORS.items():
        held = (sources & np.uint8(source.value)) != 0
        if held.any():
            yield Part(f"source {name}", *every, held)


def _range(objects: Objects) -> Float64 | None:
    """(N,) distance from the body in the ground plane [m], or as the source tells it."""
    if objects.center_m is None:
        return objects.distance_m
    return np.asarray(np.hypot(objects.center_m[:, 0], objects.center_m[:, 1]))
