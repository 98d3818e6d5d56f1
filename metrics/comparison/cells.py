"""Cells of suites as they are compared: scores, digests, and counts by stretches of time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fbench.metrics.comparison.counts import CRITICAL, FrameCounts, Place, count_frames, options_of, require_same_rules
from fbench.metrics.comparison.pairing import require_common_instants, require_comparable
from fbench.metrics.core.bootstrap import LEAST_UNITS
from fbench.metrics.runs.scoring import Pieces, cut_run
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.comparison import ComparedCell
from fbench.replay.data.metadata import SCENE_ID
from fbench.replay.data.scores import Score
from fbench.replay.runs.digest import START, digest, link
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import Manifest

CLEAR = "clear"
OTHER = " -> "  # Between the names of two pipelines that are compared with each other
LEAST_SCENES = 12
"""From so many on, whole scenes are resampled: of fewer, no test could tell a difference (2^-11 is 1/2048)."""


@dataclass(frozen=True)
class CellName:
    """Which cell of a suite; of a single run only log and pipeline are known."""

    log: str
    pipeline: str
    condition: str = CLEAR
    rate: str = ""
    seed: int = 0

    def __str__(self) -> str:
        more = [self.condition] if self.condition != CLEAR else []
        more += [f"rate {self.rate}"] if self.rate not in ("", "max") else []
        more += [f"seed {self.seed}"] if self.seed else []
        return " ".join([self.log, "through", self.pipeline, *(f"({part})" for part in more)])


@dataclass(frozen=True, eq=False)
class Stretches:
    """Counts of U stretches of time of one run."""

    unit: str  # `segments`, `stretches of 2 s` ...
    counts: Mapping[Place, Int64]  # (U, K)
    digests: tuple[str, ...]  # (U,) of the outputs in each


@dataclass(frozen=True, eq=False)
class CellSide:
    """One cell on one side: a run, or what a baseline kept of one."""

    manifest: Manifest
    scores: Sequence[Score]
    run: Run | None = None  # `None`: only a baseline is left
    kept: Stretches | None = None  # Of a baseline

    @classmethod
    def of(cls, run: Run) -> "CellSide":
        """Take a run folder."""
        return cls(run.manifest, run.scores, run)

    @cached_property
    def frames(self) -> FrameCounts:
        """Counts of each frame, as the scores were made. Raises MetricError where they weren't made by these rules."""
        if self.run is None:
            raise MetricError("a baseline has no frames; compare with the run itself")
        found = count_frames(self.run, options_of(self.scores))
        require_same_rules(found, self.scores, str(self.run.folder))
        return found

    @cached_property
    def stretches(self) -> Stretches:
        """Counts by stretches, cut at instants that depend on the log alone."""
        if self.kept is not None:
            return self.kept
        if self.run is None:
            raise MetricError("a baseline has no counts")
        return cut_into_stretches(self.run, self.frames)


def cut_into_stretches(run: Run, frames: FrameCounts) -> Stretches:
    """Add up the counts of the frames of each stretch."""
    cuts = (cut_run(run, least) for least in (LEAST_UNITS, 2, 1))  # short runs may be enough together
    cut = next((own for own in cuts if not isinstance(own, str)), "")
    labeled = [frame for frame in run.frames if frame.truth_spaces]
    if isinstance(cut, str):
        index = np.array([frame.index for frame in labeled], np.int64)
        cut = Pieces(index, np.zeros(len(index), np.int64), "the whole run", cuts_tracks=False)
    num = int(cut.piece.max(initial=-1)) + 1
    sums = {}
    for place, counts in frames.counts.items():
        total = np.zeros((num, counts.shape[1]), np.int64)
        np.add.at(total, cut.piece, counts)
        sums[place] = total
    chains = [START] * num
    for piece, frame in zip(cut.piece.tolist(), labeled, strict=True):
        chains[piece] = link(chains[piece], frame.digest or digest(None))
    return Stretches(cut.unit, sums, tuple(chains))


@dataclass(frozen=True, eq=False)
class CellPair:
    """One cell on both sides."""

    name: CellName
    base: CellSide
    head: CellSide

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What else differs. Raises MetricError, naming the cell, where the two show different things."""
        try:
            notes = require_comparable(self.base.manifest, self.head.manifest)
            if self.base.run is not None and self.head.run is not None:
                notes += require_common_instants(self.base.run, self.head.run)
        except MetricError as error:
            raise MetricError(f"{self.name}: {error}", error.code) from error
        return notes

    @property
    def is_identical(self) -> bool:
        """Whether both sides gave the same, bit by bit."""
        one, two = self.base.manifest, self.head.manifest
        is_same = bool(one.digest) and one.digest == two.digest and one.data_key == two.data_key
        values = [[(score.key, score.value) for score in side.scores] for side in (self.base, self.head)]
        return is_same and values[0] == values[1]

    @property
    def entry(self) -> ComparedCell:
        """What the comparison says of it."""
        return ComparedCell(str(self.name), self.name.pipeline, self.name.condition)

    @property
    def scene(self) -> str:
        """What the log shows: cells of one scene aren't independent."""
        entry = self.base.manifest.log
        return entry.metadata.get(SCENE_ID) or entry.log_id or entry.digest

    def counts(self, place: Place) -> tuple[Int64, Int64] | None:
        """Return counts (U, K) of both sides by stretch; `None` where neither has any, or they are cut differently, or
        one counts nothing of this kind, as old baselines of what is critical.
        """
        sides = [side.stretches for side in (self.base, self.head)]
        if place[0] in CRITICAL and any(all(own[0] != place[0] for own in side.counts) for side in sides):
            return None
        held = [side.counts.get(place) for side in sides]
        if all(own is None for own in held) or len(sides[0].digests) != len(sides[1].digests):
            return None
        width = next(own.shape[1] for own in held if own is not None)
        nothing = np.zeros((len(sides[0].digests), width), np.int64)
        one, two = (nothing if own is None else own for own in held)
        return one, two


def add_units(pairs: Sequence[CellPair], place: Place) -> tuple[Int64, Int64] | None:
    """Return counts (U, K) of both sides of cells that are judged as one: of each scene, where there are at least
    `LEAST_SCENES`, else of each stretch of each scene. `None` where no cell has any.
    """
    scenes = sorted({pair.scene for pair in pairs})
    whole = len(scenes) >= LEAST_SCENES
    sums: dict[tuple[str, int], tuple[Int64, Int64]] = {}
    for pair in pairs:
        found = pair.counts(place)
        if found is None:
            continue
        for piece, (a, b) in enumerate(zip(*found, strict=True)):
            key = (pair.scene, 0 if whole else piece)
            before = sums.get(key)
            sums[key] = (a, b) if before is None else (before[0] + a, before[1] + b)
    if not sums:
        return None
    rows = [sums[key] for key in sorted(sums)]
    return np.array([a for a, _ in rows]), np.array([b for _, b in rows])
