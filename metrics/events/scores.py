"""Scores of events: how detections and tracks do in them, and whether tracks show the same events."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from fbench.metrics.core.exact import Counts, exact_sum
from fbench.metrics.core.ordering import number_tracks
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.similarity import blocks
from fbench.metrics.core.slices import ScoreKey
from fbench.metrics.tracking.hota import ALPHAS, HotaCounts, hota_counts
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps

STABLE_S = 0.5  # A track is stable from where it follows an object for so long without a break
SLICE = "event:"  # Begin of slices that are about an event
ARRIVALS = ("time_to_track", "never_tracked")  # Metrics of objects that come into sight, over all of them
NO_EVENT = "the event doesn't occur"
_LABELS = tuple(f"{alpha:.2f}" for alpha in ALPHAS)


@dataclass(frozen=True)
class EventCounts(Counts):
    """Sufficient statistics of one event of one class."""

    events: int = 0  # Stretches of time in which one object is in it
    found: int = 0  # Truth boxes in it that a detection found
    missed: int = 0
    tracked: int = 0  # Truth boxes in it that a track found
    untracked: int = 0
    steps: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Frames that have the event in truth and in tracks, in tracks alone, in truth alone, in neither."""
    hota: HotaCounts = field(default_factory=HotaCounts)


@dataclass(frozen=True)
class ArrivalCounts(Counts):
    """From when objects are seen first to when a track follows them."""

    objects: int = 0  # That came into sight
    followed: int = 0  # Of these, those that a stable track follows at some time
    delay_s: Fraction = Fraction(0)  # Sum over these


def count_stretches(objects: Objects, own: Int64, steps: Steps) -> int:
    """Count stretches of consecutive steps in which boxes (K,) of one object are, by their rows; without an id, each
    box is one of its own.
    """
    ids = np.where(objects.track_id[own] < 0, -1 - np.arange(len(own)), objects.track_id[own])
    number, place = number_tracks(ids, steps.stream[objects.step[own]]), steps.places[objects.step[own]]
    order = np.lexsort((place, number))
    return int(((np.diff(number[order], prepend=-1) != 0) | (np.diff(place[order], prepend=-9) > 1)).sum())


def compare_steps(truth: Int64, tracks: Int64, known: Bool) -> tuple[int, int, int, int]:
    """Count steps with boxes on both sides, of tracks alone, of truth alone, on neither; by the steps of the boxes.
    Steps at which nobody knows, by `known` (S,), aren't counted.
    """
    has, says = (np.bincount(step, minlength=len(known)) > 0 for step in (truth, tracks))
    parts = has & says & known, ~has & says & known, has & ~says & known, ~has & ~says & known
    hit, alarm, miss, rest = (int(part.sum()) for part in parts)
    return hit, alarm, miss, rest


def temporal_hota(truth: Objects, tracks: Objects, steps: Steps, match: Match) -> HotaCounts:
    """Count HOTA of the boxes that are in an event, in truth and by tracks (HOTA-Temporal).

    Similarity is max(0, 1 - distance / threshold of the match), see `Problem.overlaps`.
    """

    def ids(side: Objects) -> Int64:
        alone = np.where(side.track_id < 0, np.arange(len(side)) - len(side), side.track_id)
        return number_tracks(alone, steps.stream[side.step])

    pairs = blocks(truth, tracks, len(steps), match.kind)
    rows = np.arange(len(truth)), np.arange(len(tracks))
    problem = Problem(pairs, steps.stream, ids(truth), ids(tracks), *rows)
    return hota_counts(problem.overlaps(match))


def count_arrivals(sequence: Sequence, first: Int64, truth_row: Int64, track_id: Int64) -> ArrivalCounts:
    """Count objects that are seen first at rows `first` (K,) of truth, and the time until a stable track follows them.
    For an object that is seen before it counts, outside of the region, the time begins where it counts.

    `truth_row` (N,) are rows of truth that count, `track_id` (N,) the track that found each, -1: none. A track is
    stable where it is the same, without a miss, for `STABLE_S`; the time ends where that begins.
    """
    truth, steps = sequence.truth, sequence.steps
    partner = np.full(len(truth), -2)  # -2: doesn't count
    partner[truth_row] = track_id
    place, time_s = steps.places[truth.step], (steps.stamp_ns - steps.stamp_ns[:1].sum())[truth.step] * 1e-9
    named = np.flatnonzero(truth.track_id >= 0)
    order = named[np.lexsort((place[named], truth.track_id[named], steps.stream[truth.step[named]]))]
    at = np.empty(len(truth), np.int64)
    at[order] = np.arange(len(order))
    ends = (np.diff(truth.track_id[order]) != 0) | (np.diff(steps.stream[truth.step[order]]) != 0)
    end = np.append(np.flatnonzero(ends) + 1, len(order))
    num, delays = 0, []
    for row in first.tolist():
        rows = order[at[row] : end[np.searchsorted(end, at[row], side="right")]]
        asked = rows[partner[rows] > -2]
        if not len(asked):
            continue
        num += 1
        same = (np.diff(partner[rows]) == 0) & (np.diff(place[rows]) == 1)
        for part in np.split(rows, np.flatnonzero(~same) + 1):
            if partner[part[0]] >= 0 and time_s[part[-1]] - time_s[part[0]] >= STABLE_S - 1e-9:
                delays.append(time_s[part[0]] - time_s[asked[0]])
                break
    return ArrivalCounts(num, len(delays), exact_sum(np.array(delays, np.float64)))


def value_of(metric: str, n: Mapping[str, int | float]) -> tuple[float | None, str | None]:
    """Return the value of a row from its counts, or why there is none."""

    def share(top: float, bottom: float, why: str) -> tuple[float | None, str | None]:
        return (top / bottom, None) if bottom else (None, why)

    if metric == "events":
        return n["events"], None
    if metric in ("recall", "clr_re"):
        return share(n["tp"], n["tp"] + n["fn"], NO_EVENT)
    if metric == "time_to_track":
        return share(n["delay_s"], n["followed"], "no object came into sight and was followed")
    if metric == "never_tracked":
        return n["objects"] - n["followed"], None
    if metric == "timestamp_balanced_accuracy":
        has, lacks = n["tp"] + n["fn"], n["tn"] + n["fp"]
        if not has or not lacks:
            what = "no frame" if not has else "every frame"
            return None, f"{what} of truth has the event (av2-api counts that half as 1)"
        return (n["tp"] / has + n["tn"] / lacks) / 2, None
    if not n["gt"]:
        return None, NO_EVENT
    total = 0.0
    for label in _LABELS:
        tp = n[f"tp {label}"]
        total += (n[f"assa {label}"] / (n["gt"] + n["estimates"] - tp)) ** 0.5 if tp else 0.0
    return total / len(_LABELS), None


def event_rows(n: EventCounts, head: ScoreKey, by_sight: bool, has_tracks: bool) -> list[Score]:
    """Return the rows of an event: how often it is there, then, where it is, how it is found. Whether tracks show it
    is said where it isn't there, too, so that false ones count in sums; not of events that depend on sight.
    """
    table: dict[str, Mapping[str, int | float]] = {"events": {"events": n.events}}
    if n.events:
        table["recall"] = {"tp": n.found, "fn": n.missed}
    if n.events and has_tracks:
        table["clr_re"] = {"tp": n.tracked, "fn": n.untracked}
    if has_tracks and not by_sight and not head.reason:
        hota: dict[str, int | float] = {"gt": n.hota.tp[0] + n.hota.fn[0], "estimates": n.hota.tp[0] + n.hota.fp[0]}
        for label, num, total in zip(_LABELS, n.hota.tp, n.hota.ass_a, strict=True):
            hota |= {f"tp {label}": num, f"assa {label}": float(total)}
        table |= {"hota_temporal": hota} if hota["gt"] or hota["estimates"] else {}
        table["timestamp_balanced_accuracy"] = dict(zip(("tp", "fp", "fn", "tn"), n.steps, strict=True))
    rows = []
    for metric, counts in table.items():
        if head.reason:  # without counts, so that nothing is added to what other runs know
            rows.append(head.score(metric, None, head.reason, {}))
        else:
            rows.append(head.score(metric, *value_of(metric, counts), counts))
    return rows


def arrival_rows(n: ArrivalCounts, head: ScoreKey, why: str | None) -> list[Score]:
    """Return the time to a stable track, and how many objects never got one; null, without counts, where `why` or the
    head says so.
    """
    counts: dict[str, int | float] = {"objects": n.objects, "followed": n.followed, "delay_s": float(n.delay_s)}
    rows = []
    for metric, unit in zip(ARRIVALS, ("s", "1"), strict=True):
        if unknown := head.reason or why:
            rows.append(head.score(metric, None, unknown, {}, unit))
        else:
            rows.append(head.score(metric, *value_of(metric, counts), counts, unit))
    return rows
