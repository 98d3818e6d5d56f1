"""HOTA, CLEAR and Identity as TrackEval 1.3.0 counts them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

from fbench.metrics.core.problem import Problem
from fbench.metrics.profiles.trackeval.fields import (
    LABELS,
    ClassCounts,
    Field,
    TrackingCounts,
    alpha_fields,
    alpha_raw,
    clear_fields,
    clear_raw,
    count,
    identity_fields,
    identity_raw,
    mean_fields,
    mean_raw,
)
from fbench.metrics.profiles.trackeval.prepare import HALF, KITTI, MOT15, MOT17, MOT20, Preparation, overlaps, problems
from fbench.metrics.tracking.clear import TRACKEVAL_RULES, ClearRules, clear_counts
from fbench.metrics.tracking.hota import hota_counts
from fbench.metrics.tracking.identity import identity_counts
from fbench.replay.contracts.profiles import Facts, Family, Headlines, Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

CLASS_MEAN, CLASS_SUM = "cls_comb_cls_av", "cls_comb_det_av"
"""TrackEval's names for the mean over classes and for all classes as one."""
Group = tuple[list[Field], Mapping[str, int | float], str]  # Fields, counts and matching


def tracking_scores(statistics: TrackingCounts, part: str, match: Match) -> list[Score]:
    """Return rows of all classes: means over thresholds and CLEAR and Identity first, then each threshold's HOTA."""
    classes = dict(statistics.classes)
    combined = len(classes) > 1 and part == "all"
    if combined:
        classes[CLASS_SUM] = statistics.together
    by_alpha = {name: [alpha_fields(c.hota, a) for a in range(len(LABELS))] for name, c in classes.items()}
    groups = {name: _groups(c, by_alpha[name], match) for name, c in classes.items()}
    if combined:
        groups[CLASS_MEAN] = _average(statistics, groups)
    rows = [
        field.score(name, part, how, raw) for name, of in groups.items() for fields, raw, how in of for field in fields
    ]
    for name, own in classes.items():
        rows += _alpha_rows(name, own, by_alpha[name], part, match)
    if combined:
        rows += _average_alpha_rows(statistics, by_alpha, part, match)
    return rows


def _groups(c: ClassCounts, by_alpha: list[list[Field]], match: Match) -> list[Group]:
    boxes: dict[str, int | float] = {
        "dets": c.clear.tp + c.clear.fp, "gt_dets": c.clear.num_truth, "ids": c.num_result_tracks,
        "gt_ids": c.clear.num_tracks,
    }  # fmt: skip
    return [
        (mean_fields(by_alpha), mean_raw(c.hota), _thresholds(match, "0.05 to 0.95")),
        (clear_fields(c.clear, match.is_distance), clear_raw(c.clear), str(match)),
        (identity_fields(c.identity), identity_raw(c.identity), str(match)),
        ([count(metric, value) for metric, value in boxes.items()], boxes, str(match)),
    ]


def _thresholds(match: Match, alphas: str) -> str:
    """How HOTA matches: `iou2d 0.05`, or `bev 2 m, similarity 0.05`."""
    return f"{match}, similarity {alphas}" if match.is_distance else f"{match.likeness} {alphas}"


def _alpha_rows(name: str, c: ClassCounts, by_alpha: list[list[Field]], part: str, match: Match) -> Iterator[Score]:
    for a, fields in enumerate(by_alpha):
        slice_, how, raw = _alpha_slice(part, a), _thresholds(match, LABELS[a]), alpha_raw(c.hota, a)
        for field in fields:
            yield field.score(name, slice_, how, raw)


def _alpha_slice(part: str, a: int) -> str:
    return f"alpha {LABELS[a]}" if part == "all" else f"{part}, alpha {LABELS[a]}"


def _average(statistics: TrackingCounts, groups: Mapping[str, list[Group]]) -> list[Group]:
    """Means over the classes that have boxes (`ignore_empty_classes` of TrackEval); counts are summed."""
    used = _used(statistics)
    result: list[Group] = []
    for k, (_, raw, how) in enumerate(groups[CLASS_SUM]):
        of_classes = [groups[name][k][0] for name in used]
        result.append((_means(of_classes, groups[CLASS_SUM][k][0]), raw, how))
    return result


def _used(statistics: TrackingCounts) -> list[str]:
    return [name for name, c in statistics.classes.items() if c.num_boxes]


def _average_alpha_rows(
    statistics: TrackingCounts, by_alpha: Mapping[str, list[list[Field]]], part: str, match: Match
) -> Iterator[Score]:
    used = _used(statistics)
    for a, of_sum in enumerate(by_alpha[CLASS_SUM]):
        raw = alpha_raw(statistics.together.hota, a)
        for field in _means([by_alpha[name][a] for name in used], of_sum):
            yield field.score(CLASS_MEAN, _alpha_slice(part, a), _thresholds(match, LABELS[a]), raw)


def _means(of_classes: list[list[Field]], of_sum: list[Field]) -> list[Field]:
    """Mean over classes of what the reference prints for each; undefined where no class has a value."""
    return [
        summed if summed.is_count else _mean([fields[k] for fields in of_classes], summed)
        for k, summed in enumerate(of_sum)
    ]


def _mean(fields: list[Field], summed: Field) -> Field:
    if all(field.value is None for field in fields):
        return summed._replace(value=None, why=summed.why or "no class has a value")
    mean = sum(field.printed for field in fields) / len(fields)
    return summed._replace(value=mean, printed=mean)


_HEADLINES = Headlines(
    ("hota", "deta", "assa", "loca", "mota", "motp", "idf1", "idp", "idr", "clr_re", "clr_pr", "clr_tp", "clr_fp",
     "clr_fn", "idsw", "frag", "mt", "pt", "ml")
)  # fmt: skip


@dataclass(frozen=True)
class TrackEvalProfile:
    """HOTA at 19 thresholds, CLEAR and Identity at one, for each class of a benchmark."""

    name: str
    summary: str
    preparation: Preparation
    match: Match = HALF
    rules: ClearRules = TRACKEVAL_RULES  # Floor and offset come from `match`
    family: Family = "mot"

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return Facts(True, "2d", self.family, _HEADLINES)

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return self.preparation.result_labels

    def with_match(self, match: Match) -> Self:
        """Return the profile with another likeness or threshold.

        Distances d rate matches as TrackEval rates them in MOT15's 3D: CLEAR by 1 - d / (2 threshold), its default,
        HOTA by max(0, 1 - d / threshold).
        """
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> TrackingCounts:
        """Return the statistics of one sequence. Raises MetricError where an id is missing or twice in a frame (GT003),
        or labels are of another benchmark.
        """
        found = problems(sequence, self.preparation, self.match)
        names = (rule.name for rule in self.preparation.classes)
        return TrackingCounts({name: self._counts(one) for name, one in zip(names, found, strict=True)})

    def scores(self, statistics: TrackingCounts, part: str) -> list[Score]:
        """Return rows of all classes: means over thresholds first, then those of each threshold.

        Over all sequences of several classes also their mean (`cls_comb_cls_av`) and their sum (`cls_comb_det_av`).
        """
        return tracking_scores(statistics, part, self.match)

    def clear_rules(self) -> ClearRules:
        """Return the rules of CLEAR with the floor of the match."""
        offset = 2 * self.match.threshold if self.match.is_distance else 0.0
        return replace(self.rules, floor=self.match.floor, offset=offset)

    def _counts(self, problem: Problem) -> ClassCounts:
        return ClassCounts(
            clear_counts(problem, self.clear_rules()),
            identity_counts(problem, self.match.floor),
            hota_counts(replace(problem, similarity=overlaps(problem, self.match))),
            problem.num_estimate_ids,
        )


TRACKEVAL_KITTI = TrackEvalProfile(
    "trackeval-kitti",
    "KITTI tracking in images, cars and pedestrians, as TrackEval 1.3.0 counts",
    KITTI,
    family="kitti-tracking",
)
TRACKEVAL_MOT = TrackEvalProfile(
    "trackeval-mot", "MOTChallenge 16 and 17, pedestrians, as TrackEval 1.3.0 counts", MOT17
)
TRACKEVAL_MOT20 = TrackEvalProfile("trackeval-mot20", "MOTChallenge 20, pedestrians, as TrackEval 1.3.0 counts", MOT20)
TRACKEVAL_MOT15 = TrackEvalProfile(
    "trackeval-mot15", "MOTChallenge 15, truth without classes, as TrackEval 1.3.0 counts", MOT15
)
