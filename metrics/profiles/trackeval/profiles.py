"""HOTA, CLEAR and Identity as TrackEval 1.3.0 counts them."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from fbench.metrics.core.problem import Problem
from fbench.metrics.profiles.trackeval import fields as of
from fbench.metrics.profiles.trackeval.fields import LABELS, ClassCounts, Field, TrackingCounts
from fbench.metrics.profiles.trackeval.prepare import HALF, KITTI, MOT15, MOT17, MOT20, Preparation, problems
from fbench.metrics.tracking.clear import TRACKEVAL_RULES, ClearRules, clear_counts
from fbench.metrics.tracking.hota import hota_counts
from fbench.metrics.tracking.identity import identity_counts
from fbench.replay.contracts.profiles import Facts, Family, Headlines, Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

CLASS_MEAN, CLASS_SUM = "cls_comb_cls_av", "cls_comb_det_av"
"""TrackEval's names for the mean over classes and for all classes as one."""


class _Block(NamedTuple):
    """Rows of one class that have all else in common."""

    fields: list[Field]
    counts: Mapping[str, int | float]
    matching: str
    slice: str


def _blocks(c: ClassCounts, part: str, match: Match) -> list[_Block]:
    hota, own, at = c.hota, str(match), f"{match}, similarity" if match.is_distance else match.kind
    by_alpha = [of.alpha_fields(hota, a) for a in range(len(LABELS))]
    sums = {"hota_tp": sum(hota.tp), "hota_fn": sum(hota.fn), "hota_fp": sum(hota.fp)}
    boxes: dict[str, int | float] = {
        "dets": c.clear.tp + c.clear.fp, "gt_dets": c.clear.num_truth, "ids": c.num_result_tracks,
        "gt_ids": c.clear.num_tracks,
    }  # fmt: skip
    blocks = [
        _Block(of.mean_fields(by_alpha), sums, f"{at} 0.05 to 0.95", part),
        _Block(of.clear_fields(c.clear, match.is_distance), of.clear_raw(c.clear), own, part),
        _Block(of.identity_fields(c.identity), of.identity_raw(c.identity), own, part),
        _Block([of.count(metric, value) for metric, value in boxes.items()], boxes, own, part),
    ]
    for a, label in enumerate(LABELS):
        raw = {
            "hota_tp": hota.tp[a], "hota_fn": hota.fn[a], "hota_fp": hota.fp[a],
            "similarity_sum": float(hota.similarity[a]), "assa_sum": float(hota.ass_a[a]),
            "assre_sum": float(hota.ass_re[a]), "asspr_sum": float(hota.ass_pr[a]),
        }  # fmt: skip
        alpha = f"alpha {label}" if part == "all" else f"{part}, alpha {label}"
        blocks.append(_Block(by_alpha[a], raw, f"{at} {label}", alpha))
    return blocks


def _mean(summed: Field, *fields: Field) -> Field:
    """Mean over classes of what the reference prints for each; undefined where no class has a value."""
    if summed.is_count:
        return summed
    if all(field.value is None for field in fields):
        return summed._replace(value=None, why=summed.why or "no class has a value")
    mean = sum(field.printed for field in fields) / len(fields)
    return summed._replace(value=mean, printed=mean)


_HEADLINES = Headlines(
    ("hota", "deta", "assa", "loca", "mota", "motp", "idf1", "idp", "idr", "clr_re", "clr_pr", "clr_tp", "clr_fp",
     "clr_fn", "idsw", "frag", "mt", "pt", "ml")
)  # fmt: skip


@dataclass(frozen=True)
class TracksProfile(ABC):
    """What the profiles that look for tracks in images have in common: boxes are prepared, matched and counted."""

    name: str
    summary: str
    preparation: Preparation
    match: Match = HALF
    rules: ClearRules = TRACKEVAL_RULES  # Floor and offset come from `match`

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""
        return self.preparation.result_labels

    def with_match(self, match: Match) -> Self:
        """Return the profile with another similarity or threshold.

        Distances d rate matches in TrackEval's profiles as it rates them in MOT15's 3D: CLEAR by 1 - d / (2 threshold),
        its default, HOTA by max(0, 1 - d / threshold).
        """
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> TrackingCounts:
        """Return statistics. MetricError: an id is missing or twice in a frame (GT003), labels of another benchmark."""
        found = problems(sequence, self.preparation, self.match)
        names = (rule.name for rule in self.preparation.classes)
        return TrackingCounts({name: self.count(one) for name, one in zip(names, found, strict=True)})

    @abstractmethod
    def count(self, problem: Problem) -> ClassCounts:
        """Count one class."""


@dataclass(frozen=True)
class TrackEvalProfile(TracksProfile):
    """HOTA at 19 thresholds, CLEAR and Identity at one, for each class of a benchmark."""

    family: Family = "mot"

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return Facts(True, "2d", self.family, _HEADLINES)

    def scores(self, statistics: TrackingCounts, part: str) -> list[Score]:
        """Return rows of all classes: means over thresholds, CLEAR and Identity first, then HOTA of each threshold.

        Over all sequences of several classes also their mean (`cls_comb_cls_av`) and their sum (`cls_comb_det_av`).
        """
        classes = dict(statistics.classes)
        is_combined = len(classes) > 1 and part == "all"
        if is_combined:
            classes[CLASS_SUM] = statistics.together
        blocks = {name: _blocks(c, part, self.match) for name, c in classes.items()}
        if is_combined:  # over classes that have boxes (`ignore_empty_classes` of TrackEval); counts are summed
            used = [blocks[name] for name, c in statistics.classes.items() if c.clear.tp + c.clear.fn + c.clear.fp]
            blocks[CLASS_MEAN] = [
                summed._replace(fields=list(map(_mean, summed.fields, *(block.fields for block in own))))
                for summed, *own in zip(blocks[CLASS_SUM], *used, strict=True)
            ]
        return [
            field.score(name, block.slice, block.matching, block.counts)
            for which in (slice(0, 4), slice(4, None))
            for name, own in blocks.items()
            for block in own[which]
            for field in block.fields
        ]

    def count(self, problem: Problem) -> ClassCounts:
        """Count one class."""
        match = self.match
        rules = replace(self.rules, floor=match.floor, offset=2 * match.threshold if match.is_distance else 0.0)
        clear, identity = clear_counts(problem, rules), identity_counts(problem, match.floor)
        return ClassCounts(clear, identity, hota_counts(problem.overlaps(match)), problem.num_estimate_ids)


_AS = "as TrackEval 1.3.0 counts"
TRACKEVAL_KITTI = TrackEvalProfile(
    "trackeval-kitti", f"KITTI tracking in images, cars and pedestrians, {_AS}", KITTI, family="kitti-tracking"
)
TRACKEVAL_MOT = TrackEvalProfile("trackeval-mot", f"MOTChallenge 16 and 17, pedestrians, {_AS}", MOT17)
TRACKEVAL_MOT20 = TrackEvalProfile("trackeval-mot20", f"MOTChallenge 20, pedestrians, {_AS}", MOT20)
TRACKEVAL_MOT15 = TrackEvalProfile("trackeval-mot15", f"MOTChallenge 15, truth without classes, {_AS}", MOT15)
