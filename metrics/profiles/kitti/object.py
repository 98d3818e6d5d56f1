"""The profile `kitti-object`: average precision of KITTI's object benchmark."""

import math
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.profiles.kitti import rows
from fbench.metrics.profiles.kitti.rows import KittiClass, Pairs, Tables
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match, SimilarityKind
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence


@dataclass(frozen=True)
class Difficulty:
    """Which truth must be found; results lower than the height are excused."""

    name: str
    min_height_px: float  # Truth must be higher
    max_occlusion: int
    max_truncation: float


@dataclass(frozen=True)
class ObjectClass(KittiClass):
    """From which overlap on boxes of a class match."""

    matches: tuple[Match, ...] = ()


def _matches(strict: float, loose: float) -> tuple[Match, ...]:
    """The benchmark's overlaps, then the loose ones, which are the same in the image."""
    return (
        Match("iou2d", strict), Match("ioubev", strict), Match("iou3d", strict),
        Match("ioubev", loose), Match("iou3d", loose),
    )  # fmt: skip


CLASSES = (
    ObjectClass("car", "van", _matches(0.7, 0.5)),
    ObjectClass("pedestrian", "person_sitting", _matches(0.5, 0.25)),
    ObjectClass("cyclist", "", _matches(0.5, 0.25)),
)
DIFFICULTIES = (
    Difficulty("easy", 40.0, 0, 0.15),
    Difficulty("moderate", 25.0, 1, 0.3),
    Difficulty("hard", 25.0, 2, 0.5),
)
COUNTS, IGNORED, LEFT_OUT = 0, 1, -1
"""What a result is for a class and difficulty; as in `metrics/profiles/kitti/kernels.py`."""


@dataclass(frozen=True, eq=False)
class ObjectTable:
    """N truth boxes and M results at D difficulties."""

    pairs: Pairs
    truth_ignored: Array  # (D, N) bool: of a neighboring class, or too low, occluded or truncated for the difficulty
    state: Array  # (D, M) int64: `COUNTS`, `IGNORED` or `LEFT_OUT`
    score: Float64  # (M,)
    covered: Float64  # (M,) share that a "don't care" region covers; 0 where they don't matter
    truth_alpha: Float64  # (N,) observation angle [rad], NaN where unknown
    alpha: Float64  # (M,)
    num_bad_truth: int  # Left out; what the source left out already is of any class
    num_bad_results: int  # They are false positives at every threshold
    missing: str  # What the boxes lack, so that they can't be matched in this way; empty where nothing


def object_table(
    sequence: Sequence,
    kind: ObjectClass,
    difficulties: Many[Difficulty],
    similarity: SimilarityKind,
    least: float,
    sort: bool,
) -> ObjectTable:
    """Select what counts for one class and similarity; pairs are kept from the overlap `least` on.

    Results of any class that are low have a part too: the devkit looks at the height first and excuses them. It
    compares orientation, and excuses results in "don't care" regions, in the image only.
    """
    missing, is_flat, num_steps = "", similarity == "iou2d", len(sequence.steps)
    for side, objects in (("results", sequence.estimates), ("truth", sequence.truth)):
        boxes = objects.xyxy_px if is_flat else objects.center_m
        if len(objects) and (boxes is None or np.isnan(boxes).all()):
            missing = f"{side} of {sequence.name}: no {'boxes in images' if is_flat else '3D boxes'}"
    low = np.abs(_heights(sequence.estimates)) < max(one.min_height_px for one in difficulties)
    truth = sequence.truth[np.isin(sequence.truth.label, kind.labels) & (not missing)]
    results = sequence.estimates[((sequence.estimates.label == kind.label) | low) & (not missing)]
    if sort:
        truth, results = rows.by_content(truth, sequence), rows.by_content(results, sequence)
    sound_truth, sound = rows.are_sound(truth, similarity, True), rows.are_sound(results, similarity, False)
    num_bad_truth, num_bad_results = (~sound_truth).sum(), (~sound & (results.label == kind.label)).sum()
    truth, results = truth[sound_truth], results[sound]
    height, truth_ignored, state = np.abs(_heights(results)), [], []
    for one in difficulties:
        ignored = (truth.label == kind.neighbor) | (_heights(truth) <= one.min_height_px) | rows.outside(truth)
        ignored |= rows.fill_unknown(truth.occlusion, truth, -1.0) > one.max_occlusion
        truth_ignored.append(ignored | (rows.fill_unknown(truth.truncation, truth, -1.0) > one.max_truncation))
        excused = (height < one.min_height_px) | rows.outside(results)
        state.append(np.where(excused, IGNORED, np.where(results.label == kind.label, COUNTS, LEFT_OUT)))
    return ObjectTable(
        pairs=rows.pairs_within(truth, results, num_steps, similarity, least),
        truth_ignored=np.stack(truth_ignored),
        state=np.stack(state).astype(np.int64),
        score=results.score,
        covered=rows.share_in_regions(results, sequence.truth, num_steps) if is_flat else np.zeros(len(results)),
        truth_alpha=observation_angles(truth) if is_flat else np.full(len(truth), np.nan),
        alpha=observation_angles(results) if is_flat else np.full(len(results), np.nan),
        num_bad_truth=int(num_bad_truth) + sequence.num_invalid_truth,
        num_bad_results=int(num_bad_results),
        missing=missing,
    )


def _heights(objects: Objects) -> Float64:
    rectangle = rows.rectangles(objects)
    return rectangle[:, 3] - rectangle[:, 1]


def observation_angles(objects: Objects) -> Float64:
    """Return KITTI's alpha (N,) [rad]: as given, else from the solids, NaN where there is neither."""
    if objects.alpha_rad is not None:
        return objects.alpha_rad
    if objects.center_m is None or objects.yaw_rad is None:
        return np.full(len(objects), np.nan)
    bearing: Float64 = np.arctan2(objects.center_m[:, 1], objects.center_m[:, 0])
    return bearing - objects.yaw_rad - np.pi / 2


NUM_RECALLS = 40


def object_scores(
    tables: Many[ObjectTable], kind: ObjectClass, match: Match, difficulties: Many[Difficulty], d: int, part: str
) -> list[Score]:
    """Return AP over recalls 1/40 to 1, and over 0, 0.1 to 1 as the benchmark had it until 2019, and in the image AOS.

    Thresholds are found from the scores of all tables, of one class and similarity, at difficulty `d`. A recall that
    isn't reached has no threshold, and precision 0. Raw counts are those at the lowest threshold.
    """
    # numba takes a while to import
    from fbench.metrics.core.exact import fractions
    from fbench.metrics.profiles.kitti.kernels import count_at, heading_similarity, hit_scores

    overlap, num_truth, scores, has_alpha = match.threshold, 0, [np.zeros(0)], True
    known = [
        (t.pairs.start, t.pairs.estimate, t.pairs.similarity, t.truth_ignored[d], t.state[d], t.score, overlap)
        for t in tables
    ]
    for table, own in zip(tables, known, strict=True):
        num_truth += int((~table.truth_ignored[d]).sum())
        hits = hit_scores(*own)
        scores.append(hits[~np.isnan(hits)])
    thresholds = np.array(rows.recall_thresholds(np.concatenate(scores), num_truth, NUM_RECALLS)[0], np.float64)
    found = []
    for table, own in zip(tables, known, strict=True):
        pairs, counted, asked = table.pairs, table.state[d] == COUNTS, ~table.truth_ignored[d]
        knows = np.isfinite(table.alpha[counted]).all() and np.isfinite(table.truth_alpha[asked]).all()
        turned = np.zeros(len(pairs.estimate))
        if knows:
            turned = heading_similarity(pairs.start, pairs.estimate, table.truth_alpha, table.alpha)
        has_alpha &= bool(knows)
        found.append(count_at(*own, table.covered > overlap, turned, thresholds))
        found[-1][0][:, 1] += table.num_bad_results
    counts: Int64 = np.sum([counts for counts, _ in found], axis=0)
    turns = [float(value) for value in fractions(np.sum([digits for _, digits in found], axis=0))]
    tp, fp, fn = counts[-1].tolist() if len(counts) else (0, 0, num_truth)
    raw = {
        "tp": tp, "fp": fp, "fn": fn, "gt": num_truth, "reached": len(counts),
        "invalid_truth": sum(t.num_bad_truth for t in tables),
        "invalid_results": sum(t.num_bad_results for t in tables),
    }  # fmt: skip
    why = next((table.missing for table in tables if table.missing), "")
    why = why or ("" if num_truth else "no truth boxes of this difficulty (KITTI's devkit prints 0)")
    kinds = [("ap", counts[:, 0].astype(np.float64), why)]
    if match.kind == "iou2d":
        kinds.append(("aos", np.array(turns, np.float64), why or ("" if has_alpha else "no observation angles")))
    result = []
    for name, top, reason in kinds:
        best, detected = np.zeros(NUM_RECALLS + 1), counts[:, 0] + counts[:, 1]
        np.divide(top, detected, out=best[: len(top)], where=detected > 0)
        best = np.maximum.accumulate(best[::-1])[::-1]  # from each recall on
        means = ((name, math.fsum(best[1:]) / 40), (f"{name}11", math.fsum(best[::4]) / 11))
        where = (kind.label, f"{part}, {difficulties[d].name}", str(match))
        result += [Score(n, *where, None if reason else mean, reason or None, "1", raw) for n, mean in means]
    return result


_SIMILARITY_KINDS: tuple[SimilarityKind, ...] = ("iou2d", "ioubev", "iou3d")


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

    facts: ClassVar[Facts] = Facts(
        judges_tracks=False, space="both", family="kitti-tracking",
        headlines=Headlines(("ap", "ap11", "aos"), all_matchings=True, has_levels=True),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(kind.label for kind in self.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one overlap for all classes. ConfigError if it isn't an intersection over union."""
        if match.kind not in _SIMILARITY_KINDS:
            raise ConfigError(f"{self.name}: --match {match.kind}: expected iou2d, ioubev or iou3d")
        return replace(self, classes=tuple(replace(kind, matches=(match,)) for kind in self.classes))

    def measure(self, sequence: Sequence) -> Tables[ObjectTable]:
        """Return what counts in one sequence, a table for each class and similarity."""
        kinds = self._kinds().items()
        own = (object_table(sequence, k, self.difficulties, like, least, self.sort) for (k, like), least in kinds)
        return Tables((tuple(own),))

    def scores(self, statistics: Tables[ObjectTable], part: str) -> list[Score]:
        """Return rows by class, match and difficulty."""
        tables = dict(zip(self._kinds(), zip(*statistics.tables, strict=True), strict=True))
        return [
            row
            for kind in self.classes
            for match in kind.matches
            for d in range(len(self.difficulties))
            for row in object_scores(tables[kind, match.kind], kind, match, self.difficulties, d, part)
        ]

    def _kinds(self) -> dict[tuple[ObjectClass, SimilarityKind], float]:
        """Which tables there are: class, similarity and least overlap."""
        return {
            (kind, similarity): min(match.threshold for match in kind.matches if match.kind == similarity)
            for kind in self.classes
            for similarity in _SIMILARITY_KINDS
            if any(match.kind == similarity for match in kind.matches)
        }
