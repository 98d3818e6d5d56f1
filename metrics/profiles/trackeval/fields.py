"""Fields of TrackEval 1.3.0: numbers made of statistics by class."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial, reduce
from operator import add
from typing import NamedTuple

from fbench.metrics.core.exact import Counts
from fbench.metrics.tracking.clear import ClearCounts
from fbench.metrics.tracking.hota import ALPHAS, HotaCounts
from fbench.metrics.tracking.identity import IdentityCounts
from fbench.replay.data.scores import Score


@dataclass(frozen=True)
class ClassCounts(Counts):
    """CLEAR, Identity and HOTA of one class."""

    clear: ClearCounts = field(default_factory=ClearCounts)
    identity: IdentityCounts = field(default_factory=IdentityCounts)
    hota: HotaCounts = field(default_factory=HotaCounts)
    num_result_tracks: int = 0


@dataclass(frozen=True)
class TrackingCounts(Counts):
    """Statistics of all classes."""

    classes: Mapping[str, ClassCounts]  # By name, in the profile's order

    @property
    def together(self) -> ClassCounts:
        """All classes as one, as if each were a sequence."""
        return reduce(add, self.classes.values(), ClassCounts())


Real = int | float | Fraction
NO_TRUTH, NO_RESULTS, NO_MATCH = "no truth boxes", "no results", "no matches"
NO_TRACKS, NOTHING = "no truth tracks", "neither truth boxes nor results"


class Field(NamedTuple):
    """One number, or why there is none."""

    metric: str
    value: float | None
    why: str = ""  # Why it is undefined, and what the reference prints then
    printed: float = 0.0
    """What the reference prints, also where it is undefined: its means over classes and thresholds contain that."""
    unit: str = "1"
    is_count: bool = False  # Counts are summed over classes, all else is averaged

    def score(self, class_: str, part: str, matching: str, counts: Mapping[str, int | float]) -> Score:
        """Return it as a row."""
        why = self.why if self.value is None else None
        return Score(self.metric, class_, part, matching, self.value, why, self.unit, counts)


def plain_field(metric: str, value: Real, unit: str = "1", is_count: bool = False) -> Field:
    """A number that is always defined."""
    return Field(metric, float(value), "", float(value), unit, is_count)


count = partial(plain_field, is_count=True)  # A number of boxes, tracks or frames


def share(
    metric: str, top: Real, bottom: Real, why: str, printed: float = 0.0, text: str = "", tool: str = "TrackEval",
    unit: str = "1",
) -> Field:  # fmt: skip
    """`top / bottom`, rounded once; undefined where `bottom` is 0: then the tool prints `printed`, or `text`."""
    if not bottom:
        return Field(metric, None, f"{why} ({tool} prints {text or format(printed, 'g')})", printed, unit)
    if isinstance(top, float) or isinstance(bottom, float):
        return plain_field(metric, top / bottom, unit)
    # The same as by fractions, but several times as fast.
    return plain_field(metric, top.numerator * bottom.denominator / (top.denominator * bottom.numerator), unit)


def clear_fields(c: ClearCounts, is_distance: bool) -> list[Field]:
    """All of TrackEval's CLEAR, and `mota_no_fp`, which leaves false alarms out of MOTA.

    MOTP is the mean similarity, or the mean distance [m], of matches.
    """

    def accuracy(metric: str, top: Real) -> Field:
        text = f"0 for one sequence, {float(top):g} for sums"
        return share(metric, top, c.num_truth, NO_TRUTH, float(top), text)

    if is_distance:
        mean = float(-c.similarity / c.tp) if c.tp else None
        smota = Field("smota", None, "matches are rated by distances, not by shares (TrackEval has none)")
        motp = [Field("motp", mean, NO_MATCH, mean or 0.0, "m"), plain_field("motp_sum", -c.similarity, "m")]
    else:
        smota = accuracy("smota", c.similarity - c.fp - c.switches)
        motp = [share("motp", c.similarity, c.tp, NO_MATCH), plain_field("motp_sum", c.similarity)]
    no_frames, text = "no frames of sequences with truth and results", f"0 for one sequence, {c.fp} for sums"
    raw, names = clear_raw(c), ("clr_tp", "clr_fn", "clr_fp", "idsw", "mt", "pt", "ml", "frag", "clr_frames")
    return [
        accuracy("mota", c.tp - c.fp - c.switches),
        accuracy("moda", c.tp - c.fp),
        accuracy("motal", c.tp - c.fp - (math.log10(c.switches) if c.switches else 0)),
        share("mota_no_fp", c.tp - c.switches, c.num_truth, NO_TRUTH, 0.0, "no such number"),
        smota,
        *motp,
        share("clr_re", c.tp, c.num_truth, NO_TRUTH),
        share("clr_pr", c.tp, c.tp + c.fp, NO_RESULTS),
        share("clr_f1", 2 * c.tp, 2 * c.tp + c.fn + c.fp, NOTHING),
        share("mtr", c.mostly_tracked, c.num_tracks, NO_TRACKS),
        share("ptr", c.partly_tracked, c.num_tracks, NO_TRACKS),
        share("mlr", c.mostly_lost, c.num_tracks, NO_TRACKS, 0.0, "1 for one sequence, 0 for sums"),
        share("fp_per_frame", c.fp, c.num_steps, no_frames, c.fp, text),
        *(count(name, raw[name]) for name in names),
    ]


def clear_raw(c: ClearCounts) -> dict[str, int | float]:
    """Counts that rows of CLEAR are made of."""
    return {
        "clr_tp": c.tp, "clr_fn": c.fn, "clr_fp": c.fp, "idsw": c.switches, "frag": c.fragmentations,
        "mt": c.mostly_tracked, "pt": c.partly_tracked, "ml": c.mostly_lost, "clr_frames": c.num_steps,
        "similarity_sum": float(c.similarity),
    }  # fmt: skip


def identity_fields(c: IdentityCounts) -> list[Field]:
    """All of TrackEval's Identity."""
    return [
        share("idf1", 2 * c.tp, 2 * c.tp + c.fn + c.fp, NOTHING),
        share("idr", c.tp, c.tp + c.fn, NO_TRUTH),
        share("idp", c.tp, c.tp + c.fp, NO_RESULTS),
        *(count(metric, value) for metric, value in identity_raw(c).items()),
    ]


def identity_raw(c: IdentityCounts) -> dict[str, int | float]:
    """Counts that rows of Identity are made of."""
    return {"idtp": c.tp, "idfn": c.fn, "idfp": c.fp}


LABELS = tuple(f"{alpha:.2f}" for alpha in ALPHAS)


def alpha_fields(c: HotaCounts, a: int) -> list[Field]:
    """The numbers at threshold `a` (0 to 18).

    HOTA is the root of DetA times AssA, that is of the association accuracies of all matches over all matches, misses
    and false alarms: without any match, but with boxes, it is 0.
    """
    tp, fn, fp = c.tp[a], c.fn[a], c.fp[a]
    det, recall = share("deta", tp, tp + fn + fp, NOTHING), share("detre", tp, tp + fn, NO_TRUTH)
    ass = share("assa", c.ass_a[a], tp, NO_MATCH)

    def root(metric: str, detection: Field) -> Field:
        if detection.value is None:
            return Field(metric, None, detection.why)
        return plain_field(metric, math.sqrt(detection.value * (ass.value or 0.0)))

    return [
        root("hota", det), det, ass, recall,
        share("detpr", tp, tp + fp, NO_RESULTS),
        share("assre", c.ass_re[a], tp, NO_MATCH),
        share("asspr", c.ass_pr[a], tp, NO_MATCH),
        share("loca", c.similarity[a], tp, NO_MATCH, 1.0),
        root("owta", recall),
        count("hota_tp", tp), count("hota_fn", fn), count("hota_fp", fp),
    ]  # fmt: skip


def mean_fields(by_alpha: list[list[Field]]) -> list[Field]:
    """Means over thresholds, then the numbers at the lowest one.

    A mean is undefined where no threshold has a value; else thresholds without one enter as the reference has them: 0,
    and 1 for LocA.
    """
    means = []
    for fields in zip(*by_alpha, strict=True):
        mean = sum(field.printed for field in fields) / len(fields)
        is_known = any(field.value is not None for field in fields)
        means.append(fields[0]._replace(**({"value": mean, "why": ""} if is_known else {}), printed=mean))
    at = {field.metric: field for field in by_alpha[0]}
    hota, loca = at["hota"], at["loca"]
    both = Field("hotaloca_0", None, loca.why.replace("1)", "0)"))
    if hota.value is not None and loca.value is not None:
        both = plain_field("hotaloca_0", hota.value * loca.value)
    return [*means, hota._replace(metric="hota_0"), loca._replace(metric="loca_0"), both]
