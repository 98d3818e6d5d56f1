"""The profile `kitti-object`: average precision of KITTI's object benchmark."""

import math
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fbench.metrics.profiles.kitti.object_table import (
    CLASSES,
    DIFFICULTIES,
    Difficulty,
    ObjectClass,
    ObjectTable,
    object_table,
)
from fbench.metrics.profiles.kitti.rows import recall_thresholds
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Likeness, Match
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

NUM_RECALLS = 40


@dataclass(frozen=True, eq=False)
class Curve:
    """Counts at the thresholds of recalls 0, 1/40 ...; those that weren't reached are missing."""

    num_truth: int  # Truth boxes of the difficulty
    counts: Int64  # (K, 3) hits, false positives, misses
    similarity: Float64  # (K,) sum over hits of (1 + cos) / 2 of the difference of observation angles
    has_alpha: bool
    missing: str
    num_bad_truth: int
    num_bad_results: int

    @property
    def precision(self) -> Float64:
        """Best precision (41,) from each recall on; 0 where it wasn't reached."""
        return self._envelope(self.counts[:, 0].astype(np.float64))

    @property
    def orientation(self) -> Float64:
        """Best share of similarity (41,) from each recall on."""
        return self._envelope(self.similarity)

    def _envelope(self, top: Float64) -> Float64:
        detected = self.counts[:, 0] + self.counts[:, 1]
        values = np.zeros(NUM_RECALLS + 1)
        np.divide(top, detected, out=values[: len(top)], where=detected > 0)
        return np.maximum.accumulate(values[::-1])[::-1]


def curve(tables: Many[ObjectTable], difficulty: int, overlap: float) -> Curve:
    """Find the thresholds from the scores of all tables, and count at each.

    Args:
        tables: Of one class and likeness.
        difficulty: Index.
        overlap: Boxes match above it.
    """
    from fbench.metrics.core.exact import fractions  # numba takes a while to import

    walks = [_Walk.of(table, difficulty, overlap) for table in tables]
    num_truth = sum(int((~table.truth_ignored[difficulty]).sum()) for table in tables)
    scores = np.concatenate([np.zeros(0), *(walk.hit_scores() for walk in walks)])
    thresholds = recall_thresholds(scores, num_truth, NUM_RECALLS)[0]
    own = [walk.count(thresholds) for walk in walks]
    counts = sum((counts for counts, _ in own), np.zeros((len(thresholds), 3), np.int64))
    similarity = fractions(np.sum([digits for _, digits in own], axis=0))
    return Curve(
        num_truth=num_truth,
        counts=counts,
        similarity=np.array([float(value) for value in similarity], np.float64),
        has_alpha=all(walk.has_alpha for walk in walks),
        missing=next((table.missing for table in tables if table.missing), ""),
        num_bad_truth=sum(table.num_bad_truth for table in tables),
        num_bad_results=sum(table.num_bad_results for table in tables),
    )


def object_scores(curve: Curve, kind: ObjectClass, match: Match, difficulty: Difficulty, part: str) -> list[Score]:
    """Return AP over 40 recalls and over 11, and in the image AOS."""
    counts = _counts(curve)
    why = curve.missing or ("" if curve.num_truth else "no truth boxes of this difficulty (KITTI's devkit prints 0)")
    rows = _rows("ap", curve.precision, why, counts)
    if match.likeness == "iou2d":
        rows += _rows("aos", curve.orientation, why or ("" if curve.has_alpha else "no observation angles"), counts)
    where = f"{part}, {difficulty.name}"
    return [Score(n, kind.label, where, str(match), value, reason, "1", own) for n, value, reason, own in rows]


def _counts(curve: Curve) -> Mapping[str, int]:
    """Counts at the lowest threshold, and how many of the 41 recalls have one."""
    tp, fp, fn = curve.counts[-1].tolist() if len(curve.counts) else (0, 0, curve.num_truth)
    return {
        "tp": tp, "fp": fp, "fn": fn, "gt": curve.num_truth, "reached": len(curve.counts),
        "invalid_truth": curve.num_bad_truth, "invalid_results": curve.num_bad_results,
    }  # fmt: skip


def _rows(
    name: str, envelope: Float64, why: str, counts: Mapping[str, int]
) -> list[tuple[str, float | None, str | None, Mapping[str, int]]]:
    """The mean over recalls 1/40 to 1, and over 0, 0.1 to 1 as the benchmark had it until 2019."""
    values = ((name, math.fsum(envelope[1:]) / 40), (f"{name}11", math.fsum(envelope[::4]) / 11))
    return [(metric, None if why else value, why or None, counts) for metric, value in values]


@dataclass(frozen=True, eq=False)
class _Walk:
    """One table at one difficulty and overlap."""

    table: ObjectTable
    difficulty: int
    overlap: float
    has_alpha: bool

    @classmethod
    def of(cls, table: ObjectTable, difficulty: int, overlap: float) -> "_Walk":
        counted = table.state[difficulty] == 0
        found = ~table.truth_ignored[difficulty]
        has_alpha = np.isfinite(table.alpha[counted]).all() and np.isfinite(table.truth_alpha[found]).all()
        return cls(table, difficulty, overlap, bool(has_alpha))

    def hit_scores(self) -> Float64:
        """Scores (H,) of hits when all results count."""
        from fbench.metrics.profiles.kitti.kernels import hit_scores  # numba takes a while to import

        table, pairs, d = self.table, self.table.pairs, self.difficulty
        scores = hit_scores(
            pairs.start, pairs.estimate, pairs.likeness, table.truth_ignored[d], table.state[d], table.score,
            self.overlap,
        )  # fmt: skip
        hits: Float64 = scores[~np.isnan(scores)]
        return hits

    def count(self, thresholds: tuple[float, ...]) -> tuple[Int64, Int64]:
        """Return counts (K, 3) and digits (K, LIMBS) of the sum of similarity of heading."""
        from fbench.metrics.profiles.kitti.kernels import count_at, heading_similarity

        table, pairs, d = self.table, self.table.pairs, self.difficulty
        if self.has_alpha:
            turned = heading_similarity(pairs.start, pairs.estimate, table.truth_alpha, table.alpha)
        else:
            turned = np.zeros(len(pairs.estimate))
        counts, digits = count_at(
            pairs.start, pairs.estimate, pairs.likeness, table.truth_ignored[d], table.state[d], table.score,
            self.overlap, table.covered > self.overlap, turned, np.array(thresholds, np.float64),
        )  # fmt: skip
        counts[:, 1] += table.num_bad_results
        return counts, digits


_LIKENESSES: tuple[Likeness, ...] = ("iou2d", "ioubev", "iou3d")


@dataclass(frozen=True)
class ObjectStatistics:
    """Tables of sequences, one for each class and likeness of the profile.

    Thresholds depend on the scores of all sequences, so boxes are kept and counted at the end.
    """

    tables: tuple[tuple[ObjectTable, ...], ...]

    def __add__(self, other: "ObjectStatistics") -> "ObjectStatistics":
        return ObjectStatistics(self.tables + other.tables)


_FACTS = Facts(
    judges_tracks=False, space="both", family="kitti-tracking",
    headlines=Headlines(("ap", "ap11", "aos"), all_matchings=True, has_levels=True),
)  # fmt: skip


@dataclass(frozen=True)
class KittiObject:
    """KITTI's object devkit (Geiger et al., CVPR 2012; 40 recalls: Simonelli et al., ICCV 2019), as OpenPCDet 8cacccec
    has it in `kitti_object_eval_python`, but with overlaps in double precision.

    Truth rows choose in turn, so that where two of them compete for one result the order of rows decides; `sort`
    puts them in an order of their own, which the devkit doesn't. Where a threshold leaves neither a hit nor a false
    positive, precision is 0 there (NaN in OpenPCDet).
    """

    classes: tuple[ObjectClass, ...] = CLASSES
    difficulties: tuple[Difficulty, ...] = DIFFICULTIES
    sort: bool = False
    name: str = "kitti-object"
    summary: str = (
        "KITTI object AP and AOS over 40 and 11 recalls: in the image, from above, in 3D (OpenPCDet 8cacccec)"
    )

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return _FACTS

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(kind.label for kind in self.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one overlap for all classes. Raises ConfigError where it isn't an intersection over
        union.
        """
        if match.likeness not in _LIKENESSES:
            raise ConfigError(f"{self.name}: --match {match.likeness}: expected iou2d, ioubev or iou3d")
        return replace(self, classes=tuple(replace(kind, matches=(match,)) for kind in self.classes))

    def measure(self, sequence: Sequence) -> ObjectStatistics:
        """Return what counts in one sequence."""
        return ObjectStatistics(
            (
                tuple(
                    object_table(sequence, kind, self.difficulties, likeness, least, self.sort)
                    for kind, likeness, least in self._kinds()
                ),
            )
        )

    def scores(self, statistics: ObjectStatistics, part: str) -> list[Score]:
        """Return rows by class, match and difficulty."""
        position = {(kind.label, likeness): i for i, (kind, likeness, _) in enumerate(self._kinds())}
        rows = []
        for kind in self.classes:
            for match in kind.matches:
                tables = [own[position[kind.label, match.likeness]] for own in statistics.tables]
                for d, difficulty in enumerate(self.difficulties):
                    found = curve(tables, d, match.threshold)
                    rows += object_scores(found, kind, match, difficulty, part)
        return rows

    def _kinds(self) -> list[tuple[ObjectClass, Likeness, float]]:
        """Which tables there are: class, likeness and least overlap."""
        return [
            (kind, likeness, min(match.threshold for match in kind.matches if match.likeness == likeness))
            for kind in self.classes
            for likeness in _LIKENESSES
            if any(match.likeness == likeness for match in kind.matches)
        ]
