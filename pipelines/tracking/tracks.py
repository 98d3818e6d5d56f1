"""Lifetime of tracks: birth, measurements, misses and end."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.params import TrackerParams
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import LABELS, VEHICLES
from fbench.replay.geometry.transforms import wrap_angle

Columns: TypeAlias = dict[str, Array]
"""Arrays (T, ...) by name, all with equally many rows."""


def rows(columns: Columns, at: Array) -> Columns:
    """Select rows by mask or index array."""
    return {name: column[at] for name, column in columns.items()}


def join_columns(first: Columns, second: Columns) -> Columns:
    """Put rows of the same columns one below the other."""
    return {name: np.concatenate([column, second[name]]) for name, column in first.items()}


def overwritten(columns: Columns, at: Array, new: Columns) -> Columns:
    """Replace the rows `at` by those of `new`."""
    return {name: overwritten_rows(column, at, new[name]) for name, column in columns.items()}


def overwritten_rows(column: Array, at: Array, new: Array) -> Array:
    """Replace the rows `at` of one array; texts get the room that the longest one needs."""
    result = column.astype(np.result_type(column, new)) if column.dtype.kind == "U" else column.copy()
    result[at] = new
    return result


_FAINT = 1e-3
"""What a vote with a negative score counts: scores that are no probabilities name a label all the same."""
_LABEL = {label: i for i, label in enumerate(LABELS) if label != "other"}
_LABELS = np.array(LABELS)
_KINDS = {"other": 0, **{label: 1 + i for label, i in _LABEL.items()}, **dict.fromkeys(VEHICLES, 1 + len(LABELS))}
"""Numbers of what can be one object; 0: anything."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """T tracks in the order of their ids."""

    track_id: Int64
    """(T,)."""
    hits: Int64
    """(T,) how often it was measured."""
    missed: Int64
    """(T,) steps in which it was looked for since it was measured last."""
    updated_ns: Int64
    """(T,) stamp of the last measurement."""
    votes: Float64
    """(T, labels) sum of the scores with which each label was detected."""
    states: States
    last: Columns
    """(T,) the detection that measured each track last; carries what isn't filtered."""

    def __len__(self) -> int:
        return len(self.track_id)

    def rows(self, at: Int64) -> "Tracks":
        """Select tracks by index."""
        return Tracks(
            self.track_id[at], self.hits[at], self.missed[at], self.updated_ns[at], self.votes[at],
            self.states.rows(at), rows(self.last, at),
        )  # fmt: skip

    def labels(self) -> Text:
        """The label with the most votes (T,); of equals the first in `LABELS`, and `other` where nothing was said."""
        best = _LABELS[np.argmax(self.votes, axis=1)]
        return np.where(self.votes.any(axis=1), best, "other")


def first_tracks(detections: Columns, states: States, first_id: int, stamp_ns: int) -> Tracks:
    """Begin one track a detection."""
    num = len(states)
    return Tracks(
        first_id + np.arange(num), np.ones(num, np.int64), np.zeros(num, np.int64),
        np.full(num, stamp_ns, np.int64), ballots(detections["label"], detections["score"]), states, detections,
    )  # fmt: skip


def measured_tracks(tracks: Tracks, at: Int64, detections: Columns, states: States, stamp_ns: int) -> Tracks:
    """Give the tracks `at` their detections and corrected states; the others have missed one more step."""
    hits, missed = tracks.hits.copy(), tracks.missed + 1
    updated_ns, votes = tracks.updated_ns.copy(), tracks.votes.copy()
    hits[at] += 1
    missed[at] = 0
    updated_ns[at] = stamp_ns
    votes[at] += ballots(detections["label"], detections["score"])
    last = overwritten(tracks.last, at, detections)
    return Tracks(tracks.track_id, hits, missed, updated_ns, votes, tracks.states.overwritten(at, states), last)


def selected(tracks: Tracks, which: Bool) -> Tracks:
    """Tracks of a mask (T,)."""
    return tracks if which.all() else tracks.rows(np.flatnonzero(which))


def shown(tracks: Tracks, stamp_ns: int, steps: int, params: TrackerParams) -> Bool:
    """Which tracks are reported (T,): confirmed ones that weren't missed too often or for too long.

    Args:
        tracks: At the instant `stamp_ns`.
        stamp_ns: Now.
        steps: Done since the reset; in the first ones fewer hits are enough.
        params: Of the tracker.
    """
    confirmed = tracks.hits >= min(params.min_hits, steps)
    coasted_s = (stamp_ns - tracks.updated_ns) * 1e-9
    is_proven = tracks.hits >= tracks.missed * params.hits_per_missed
    result: Bool = (
        confirmed & is_proven & (tracks.missed <= params.max_missed_shown) & (coasted_s <= params.max_coast_s)
    )
    return result


def surviving(tracks: Tracks, min_hits: int, max_missed: int) -> Bool:
    """Which tracks go on (T,): measured now, or confirmed by `min_hits` and missed at most `max_missed` times."""
    going_on: Bool = (tracks.missed == 0) | ((tracks.hits >= min_hits) & (tracks.missed <= max_missed))
    return going_on


def join_tracks(first: Tracks, second: Tracks) -> Tracks:
    """Put two sets of tracks into one."""
    return Tracks(
        np.concatenate([first.track_id, second.track_id]),
        np.concatenate([first.hits, second.hits]),
        np.concatenate([first.missed, second.missed]),
        np.concatenate([first.updated_ns, second.updated_ns]),
        np.concatenate([first.votes, second.votes]),
        kalman.join(first.states, second.states),
        join_columns(first.last, second.last),
    )


def ballots(label: Text, score: Float64) -> Float64:
    """One row of `Tracks.votes` a detection: its score at its label; `other` says nothing, so it has no vote."""
    votes = np.zeros((len(label), len(LABELS) + 1))
    column = [_LABEL.get(name, -1) for name in label.tolist()]
    votes[np.arange(len(label)), column] = np.where(score >= 0, score, _FAINT)
    return votes[:, :-1]


def rivals(a: Text, b: Text) -> Bool:
    """Which labels (N,) and (M,) can't be one object: car and van can, car and pedestrian not; `other` is anything."""
    names = a.tolist(), b.tolist()
    kind = {name: _KINDS.get(name, -i) for i, name in enumerate(dict.fromkeys(names[0] + names[1]), 1)}
    if len(set(kind.values()) - {0}) < 2:
        return np.zeros((len(a), len(b)), np.bool_)
    first, second = (np.array([kind[name] for name in of], np.int64) for of in names)
    different: Bool = first[:, None] != second[None, :]
    different[first == 0] = False
    different[:, second == 0] = False
    return different


def seconds_since(last_ns: int, stamp_ns: int) -> float:
    """Time step of a filter [s].

    Raises:
        DataError: where time doesn't go forward.
    """
    if stamp_ns <= last_ns:
        raise DataError(f"tracker: stamp {stamp_ns} isn't after {last_ns}, reset trackers where a segment begins")
    return (stamp_ns - last_ns) * 1e-9


def weight(hits: Int64, least: float) -> Float64:
    """Share (T,) of the newest of `hits` measurements in their mean: one of all at first, and never below `least`.

    With 0 the mean is that of all measurements, with 1 it is the last one.
    """
    return np.maximum(1.0 / hits, least)


def mean_of(before: Float64, now: Float64, share: Float64) -> Float64:
    """Mean of what was (T, ...) and a new measurement with its share (T,)."""
    share = share.reshape(share.shape + (1,) * (now.ndim - 1))
    return before + share * (now - before)


def mean_yaw(before: Float64, now: Float64, share: Float64) -> tuple[Float64, Bool]:
    """Mean heading (T,) [rad], and which measurements (T,) pointed backwards: they count turned by pi."""
    change = wrap_angle(now - before)
    backwards = np.abs(change) > np.pi / 2
    change = np.where(backwards, wrap_angle(change + np.pi), change)
    return wrap_angle(before + share * change), backwards


def coasted_score(score: Float64, predicted: Bool, share: float) -> Float64:
    """Scores (T,), those of predicted tracks lowered to a share; negative ones, which are no probabilities, stay."""
    return score if share == 1.0 else np.where(predicted & (score > 0), score * share, score)
