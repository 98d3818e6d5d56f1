"""Numbers made of statistics: what TrackEval 1.3.0 calls fields."""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from fbench.metrics.tracking.clear import ClearCounts
from fbench.metrics.tracking.identity import IdentityCounts
from fbench.replay.scores import Score

Real = int | float | Fraction
NO_TRUTH, NO_RESULTS, NO_MATCH = "no truth boxes", "no results", "no matches"
NO_TRACKS, NOTHING = "no truth tracks", "neither truth boxes nor results"


class Field(NamedTuple):
    """One number, or why there is none."""

    metric: str
    value: float | None
    why: str = ""
    """Why it is undefined, and what the reference prints then."""
    printed: float = 0.0
    """What the reference prints, also where it is undefined: its means over classes and thresholds contain that."""
    unit: str = "1"
    is_count: bool = False
    """Counts are summed over classes, all else is averaged."""

    def score(self, class_: str, part: str, matching: str, counts: Mapping[str, int | float]) -> Score:
        """Return it as a row."""
        why = self.why if self.value is None else None
        return Score(self.metric, class_, part, matching, self.value, why, self.unit, counts)


def known(metric: str, value: Real, unit: str = "1") -> Field:
    """A number that is always defined."""
    return Field(metric, float(value), "", float(value), unit)


def count(metric: str, value: Real) -> Field:
    """A number of boxes, tracks or frames."""
    return Field(metric, float(value), "", float(value), is_count=True)


def share(metric: str, top: Real, bottom: Real, why: str, printed: float = 0.0, text: str = "") -> Field:
    """`top / bottom`, undefined where `bottom` is 0; the reference then prints `printed`, or what `text` says."""
    if bottom:
        value = divided(top, bottom)
        return Field(metric, value, "", value)
    return Field(metric, None, f"{why} (TrackEval prints {text or format(printed, 'g')})", printed)


def divided(top: Real, bottom: Real) -> float:
    """`top / bottom`, rounded once; the same as by fractions, but several times as fast."""
    if isinstance(top, float) or isinstance(bottom, float):
        return float(top / bottom)
    return top.numerator * bottom.denominator / (top.denominator * bottom.numerator)


def clear_fields(c: ClearCounts, is_distance: bool) -> list[Field]:
    """All of TrackEval's CLEAR, and `mota_no_fp`, which leaves false alarms out of MOTA."""
    return [*_accuracies(c, is_distance), *_precision(c, is_distance), *_ratios(c), *_counts(c)]


def _accuracies(c: ClearCounts, is_distance: bool) -> list[Field]:
    def accuracy(metric: str, errors: float) -> Field:
        top = c.tp - c.fp - errors
        text = f"0 for one sequence, {top:g} for sums"
        return share(metric, top, c.num_truth, NO_TRUTH, top, text)

    fields = [
        accuracy("mota", c.switches),
        accuracy("moda", 0),
        accuracy("motal", math.log10(c.switches) if c.switches else 0),
        share("mota_no_fp", c.tp - c.switches, c.num_truth, NO_TRUTH, 0.0, "no such number"),
    ]
    if is_distance:
        return [*fields, Field("smota", None, "matches are rated by distances, not by shares (TrackEval has none)")]
    top = c.similarity - c.fp - c.switches
    text = f"0 for one sequence, {float(top):g} for sums"
    return [*fields, share("smota", top, c.num_truth, NO_TRUTH, float(top), text)]


def _precision(c: ClearCounts, is_distance: bool) -> list[Field]:
    """MOTP: mean similarity, or mean distance [m], of matches."""
    if not is_distance:
        return [share("motp", c.similarity, c.tp, NO_MATCH), known("motp_sum", c.similarity)]
    mean = float(-c.similarity / c.tp) if c.tp else None
    return [Field("motp", mean, NO_MATCH, mean or 0.0, "m"), known("motp_sum", -c.similarity, "m")]


def _ratios(c: ClearCounts) -> list[Field]:
    no_frames, text = "no frames of sequences with truth and results", f"0 for one sequence, {c.fp} for sums"
    return [
        share("clr_re", c.tp, c.num_truth, NO_TRUTH),
        share("clr_pr", c.tp, c.tp + c.fp, NO_RESULTS),
        share("clr_f1", 2 * c.tp, 2 * c.tp + c.fn + c.fp, NOTHING),
        share("mtr", c.mostly_tracked, c.num_tracks, NO_TRACKS),
        share("ptr", c.partly_tracked, c.num_tracks, NO_TRACKS),
        share("mlr", c.mostly_lost, c.num_tracks, NO_TRACKS, 0.0, "1 for one sequence, 0 for sums"),
        share("fp_per_frame", c.fp, c.num_steps, no_frames, c.fp, text),
    ]


def _counts(c: ClearCounts) -> list[Field]:
    named = {
        "clr_tp": c.tp, "clr_fn": c.fn, "clr_fp": c.fp, "idsw": c.switches, "mt": c.mostly_tracked,
        "pt": c.partly_tracked, "ml": c.mostly_lost, "frag": c.fragmentations, "clr_frames": c.num_steps,
    }  # fmt: skip
    return [count(metric, value) for metric, value in named.items()]


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
        count("idtp", c.tp),
        count("idfn", c.fn),
        count("idfp", c.fp),
    ]


def identity_raw(c: IdentityCounts) -> dict[str, int | float]:
    """Counts that rows of Identity are made of."""
    return {"idtp": c.tp, "idfn": c.fn, "idfp": c.fp}
