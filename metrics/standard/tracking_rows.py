"""What is printed of tracks."""

from collections.abc import Sequence
from fractions import Fraction

from fbench.metrics.standard.entries import Heading
from fbench.metrics.standard.survival import survival_rows
from fbench.metrics.standard.tracking import TrackingCounts
from fbench.metrics.tracking.hota import HotaCounts
from fbench.replay.scores import Score, ratio


def tracking_rows(n: TrackingCounts, head: Heading, unit: str) -> list[Score]:
    """Return the rows of one class, MOTA first.

    Args:
        n: What was counted.
        head: What it is of.
        unit: Of MOTP: `m` where boxes match by distance, else `iou`.
    """
    nothing = head.reason or (None if n.boxes.gt else "no truth boxes")
    undefined = nothing or _no_ids(n)
    rows = _clear_rows(n, head, nothing, undefined, unit)
    rows += _identity_rows(n, head, undefined)
    rows += _hota_rows(n.hota, head, undefined)
    return rows + survival_rows(n.survival, head.class_, head.matching, undefined, head.slice)


def _clear_rows(
    n: TrackingCounts, head: Heading, nothing: str | None, undefined: str | None, unit: str
) -> list[Score]:  # fmt: skip
    boxes, clear = n.boxes, n.clear
    counts = {**boxes.named(with_predicted=False), "gt": boxes.gt, "idsw": clear.switches, "frames": head.num_frames}
    gt, why = (0 if undefined else boxes.gt), undefined or ""
    found = boxes.gt - boxes.fn - clear.switches
    total = abs(float(clear.similarity)) if unit == "m" else float(clear.similarity)
    of = head.class_, head.matching
    rows = [
        ratio("mota", *of, found - boxes.fp, gt, why, counts, part=head.slice),
        ratio("mota_no_fp", *of, found, gt, why, counts, part=head.slice),
        ratio(
            "motp", *of, total, boxes.tp, nothing or "no matches",
            {**counts, "similarity_sum": float(clear.similarity)}, unit, head.slice,
        ),
    ]  # fmt: skip
    lives = {"mt": clear.mostly_tracked, "pt": clear.partly_tracked, "ml": clear.mostly_lost}
    tracks = {**lives, "tracks": clear.num_tracks}
    rows.append(_count("idsw", clear.switches, head, undefined, counts))
    rows.append(_count("frag", clear.fragmentations, head, undefined, {"frag": clear.fragmentations}))
    return rows + [_count(name, num, head, undefined, tracks) for name, num in lives.items()]


def _count(name: str, num: int, head: Heading, undefined: str | None, counts: dict[str, int]) -> Score:
    value = None if undefined else float(num)
    return Score(name, head.class_, head.slice, head.matching, value, undefined, "1", counts)


def _identity_rows(n: TrackingCounts, head: Heading, undefined: str | None) -> list[Score]:
    i = n.identity
    counts = {"idtp": i.tp, "idfp": i.fp, "idfn": i.fn}
    table = (("idf1", i.tp + i.fp / 2 + i.fn / 2), ("idp", i.tp + i.fp), ("idr", i.tp + i.fn))
    return [
        ratio(
            name, head.class_, head.matching, i.tp, 0 if undefined else bottom, undefined or "no tracks", counts,
            part=head.slice,
        )
        for name, bottom in table
    ]  # fmt: skip


def _hota_rows(n: HotaCounts, head: Heading, undefined: str | None) -> list[Score]:
    """Means over the 19 thresholds."""
    tp, gt, estimates = sum(n.tp), n.tp[0] + n.fn[0], n.tp[0] + n.fp[0]
    counts = {"gt": gt, "estimates": estimates, "tp_sum": tp}
    det = [_share(t, t + fn + fp) for t, fn, fp in zip(n.tp, n.fn, n.fp, strict=True)]
    ass = [_share(a, t) for a, t in zip(n.ass_a, n.tp, strict=True)]
    loc = [_share(s, t) for s, t in zip(n.similarity, n.tp, strict=True) if t]
    values = (
        ("hota", _mean([(d * a) ** 0.5 for d, a in zip(det, ass, strict=True)]), undefined),
        ("deta", _mean(det), undefined),
        ("assa", _mean(ass), undefined),
        ("loca", _mean(loc) if loc else None, undefined or (None if loc else "no matches")),
    )
    return [
        Score(name, head.class_, head.slice, head.matching, None if why else value, why, "1", counts)
        for name, value, why in values
    ]


def _share(top: int | Fraction, bottom: int) -> float:
    return float(top / bottom) if bottom else 0.0


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _no_ids(n: TrackingCounts) -> str | None:
    if not n.num_truth_ids:
        return "truth has no track ids"
    return "tracks have no ids" if n.num_estimates and not n.num_estimate_ids else None
