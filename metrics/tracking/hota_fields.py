"""HOTA's numbers: at each threshold, and their means, as TrackEval 1.3.0 gives them."""

import math

from fbench.metrics.tracking.fields import NO_MATCH, NO_RESULTS, NO_TRUTH, NOTHING, Field, count, known, share
from fbench.metrics.tracking.hota import ALPHAS, HotaCounts

LABELS = tuple(f"{alpha:.2f}" for alpha in ALPHAS)


def alpha_fields(c: HotaCounts, a: int) -> list[Field]:
    """The numbers at threshold `a` (0 to 18).

    HOTA is the root of DetA times AssA, that is of the association accuracies of all matches over all matches, misses
    and false alarms: without any match, but with boxes, it is 0.
    """
    tp, fn, fp = c.tp[a], c.fn[a], c.fp[a]
    det, recall = share("deta", tp, tp + fn + fp, NOTHING), share("detre", tp, tp + fn, NO_TRUTH)
    ass = share("assa", c.ass_a[a], tp, NO_MATCH)
    return [
        _root("hota", det, ass), det, ass, recall,
        share("detpr", tp, tp + fp, NO_RESULTS),
        share("assre", c.ass_re[a], tp, NO_MATCH),
        share("asspr", c.ass_pr[a], tp, NO_MATCH),
        share("loca", c.similarity[a], tp, NO_MATCH, 1.0),
        _root("owta", recall, ass),
        count("hota_tp", tp), count("hota_fn", fn), count("hota_fp", fp),
    ]  # fmt: skip


def _root(metric: str, detection: Field, association: Field) -> Field:
    if detection.value is None:
        return Field(metric, None, detection.why)
    return known(metric, math.sqrt(detection.value * (association.value or 0.0)))


def mean_fields(by_alpha: list[list[Field]]) -> list[Field]:
    """Means over thresholds, then the numbers at the lowest one.

    A mean is undefined where no threshold has a value; else thresholds without one enter as the reference has them: 0,
    and 1 for LocA.
    """
    return [*map(_mean, zip(*by_alpha, strict=True)), *_lowest(by_alpha[0])]


def _mean(fields: tuple[Field, ...]) -> Field:
    first = fields[0]
    mean = sum(field.printed for field in fields) / len(fields)
    if all(field.value is None for field in fields):
        return Field(first.metric, None, first.why, mean)
    return count(first.metric, mean) if first.is_count else known(first.metric, mean)


def _lowest(fields: list[Field]) -> list[Field]:
    at = {field.metric: field for field in fields}
    hota, loca = at["hota"], at["loca"]
    both = Field("hotaloca_0", None, loca.why.replace("1)", "0)"))
    if hota.value is not None and loca.value is not None:
        both = known("hotaloca_0", hota.value * loca.value)
    return [
        Field("hota_0", hota.value, hota.why, hota.printed),
        Field("loca_0", loca.value, loca.why, loca.printed),
        both,
    ]


def alpha_raw(c: HotaCounts, a: int) -> dict[str, int | float]:
    """Counts that rows at threshold `a` are made of."""
    return {
        "hota_tp": c.tp[a], "hota_fn": c.fn[a], "hota_fp": c.fp[a], "similarity_sum": float(c.similarity[a]),
        "assa_sum": float(c.ass_a[a]), "assre_sum": float(c.ass_re[a]), "asspr_sum": float(c.ass_pr[a]),
    }  # fmt: skip


def mean_raw(c: HotaCounts) -> dict[str, int | float]:
    """Counts over all thresholds."""
    return {"hota_tp": sum(c.tp), "hota_fn": sum(c.fn), "hota_fp": sum(c.fp)}
