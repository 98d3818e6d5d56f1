"""Slices of a sequence, groups of classes, and statistics labeled by them."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from fbench.replay.contracts.profiles import Statistics
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import VEHICLES, Source
from fbench.replay.data.scores import Score, ratio
from fbench.replay.data.sequences import Objects, Sequence

RANGES_M = (0.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0)
VISIBILITIES = (0.0, 0.4, 0.6, 0.8, 1.0)  # The steps that nuScenes labels
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
    truth: Bool  # (N,)
    estimates: Bool  # (M,)
    given: Bool | None = None  # (M,) false for estimates that aren't there at all; `None`: all are


def by_seen(sequence: Sequence) -> Iterator[Part]:
    """Yield what some sensor of the log sees, where truth tells."""
    if sequence.truth.seen is not None:
        yield Part("seen", sequence.truth.seen, np.ones(len(sequence.estimates), bool))


def by_range(sequence: Sequence, range_m: float) -> Iterator[Part]:
    """Yield the sequence by distance in the ground plane, as far as `range_m`."""
    truth, estimates = ground_range(sequence.truth), ground_range(sequence.estimates)
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


def ground_range(objects: Objects) -> Float64 | None:
    """Distance (N,) from the body in the ground plane [m], else as the source reports it."""
    c = objects.center_m
    return objects.distance_m if c is None else np.asarray(np.hypot(c[:, 0], c[:, 1]))


@dataclass(frozen=True)
class Group:
    """Labels that are scored as one class; the label among them isn't compared."""

    name: str
    labels: tuple[str, ...]
    agnostic: bool  # Whether boxes without a label belong to it

    def holds(self, objects: Objects) -> Bool:
        """Tell which objects (N,) are of this class."""
        own: Bool = np.isin(objects.label, self.labels)
        return own | (objects.label == "") if self.agnostic else own

    def counts(self, truth: Objects) -> Bool:
        """Tell which truth boxes (N,) must be found: of this class, in the region, not ignored."""
        held = self.holds(truth)
        held = held if truth.inside is None else held & truth.inside
        return held if truth.ignore is None else held & ~truth.ignore

    def excuses(self, truth: Objects, estimates: Objects) -> tuple[Bool, Bool]:
        """Tell which truth boxes (N,) that needn't be found excuse any estimate, and which estimates (M,) any excuses.

        Truth of this class does always. An ignore region without a class, too. Truth of another class does so
        only for estimates that have no label: a labeled one has the wrong label.
        """
        always = self.holds(truth)
        if truth.ignore is not None:
            always |= truth.ignore & np.isin(truth.label, ["", "other"])
        return always, np.asarray(estimates.label == "")


VEHICLE = Group("vehicle", VEHICLES, agnostic=True)


def label_group(label: str) -> Group:
    """Return the group of one label alone."""
    return Group(label, (label,), agnostic=False)


def find_labels(truth: Objects, estimates: Objects) -> set[str]:
    """Return the labels of estimates and of truth that isn't ignored."""
    asked = truth.label if truth.ignore is None else truth.label[~truth.ignore]
    return {*np.unique(asked).tolist(), *np.unique(estimates.label).tolist()}


S = TypeVar("S", bound=Statistics)


@dataclass(frozen=True)
class ScoreKey:
    """What the rows of one class in one space have in common."""

    class_: str
    slice: str
    matching: str
    reason: str | None = None  # Why nothing can be scored
    num_frames: int = 0  # That were scored

    def score(
        self, metric: str, value: float | None, reason: str | None, counts: Mapping[str, int | float], unit: str = "1"
    ) -> Score:
        """Return one row; null with the reason where there is one."""
        own = (self.class_, self.slice, self.matching)
        return Score(metric, *own, None if reason else value, reason or None, unit, counts)

    def ratio(
        self, metric: str, top: float, bottom: float, why: str, counts: Mapping[str, int | float], unit: str = "1"
    ) -> Score:
        """Return `top / bottom` as one row; null with the reason `why` where `bottom` is 0."""
        return ratio(metric, self.class_, self.matching, top, bottom, why, counts, unit, self.slice)


@dataclass(frozen=True)
class ScoreCounts(Generic[S]):
    """The statistics of one class, slice and space."""

    key: ScoreKey
    counts: S

    @property
    def place(self) -> tuple[str, str, str]:
        """What tells it apart from others: class, slice and matching."""
        return self.key.class_, self.key.slice, self.key.matching

    def __add__(self, other: "ScoreCounts[S]") -> "ScoreCounts[S]":
        one, two = self.key, other.key
        reason = one.reason if one.reason and two.reason else None
        key = replace(one, reason=reason, num_frames=one.num_frames + two.num_frames)
        return ScoreCounts(key, self.counts + other.counts)


def add_counts(tables: Iterable[Iterable[ScoreCounts[S]]]) -> tuple[ScoreCounts[S], ...]:
    """Add the entries of several runs; what only some of them have stays, in the order in which it first comes."""
    sums: dict[tuple[str, str, str], ScoreCounts[S]] = {}
    for entry in itertools.chain.from_iterable(tables):
        sums[entry.place] = sums[entry.place] + entry if entry.place in sums else entry
    return tuple(sums.values())
