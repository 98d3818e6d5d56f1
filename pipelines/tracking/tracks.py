"""Tracks, in images and in space alike: their columns and labels, and detections in an order that content decides."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from fbench.pipelines.tracking.kalman import States
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import LABELS, MAX_MAGNITUDE, VEHICLES

Columns: TypeAlias = dict[str, Array]  # Arrays (T, ...) by name, all with equally many rows

_FAINT = 1e-3  # What a vote with a negative score counts: scores that are no probabilities name a label all the same
_LABEL = {label: i for i, label in enumerate(LABELS) if label != "other"}
_LABELS = np.array(LABELS)
_KINDS = {"other": 0, **{label: 1 + i for label, i in _LABEL.items()}, **dict.fromkeys(VEHICLES, 1 + len(LABELS))}
"""Numbers of what can be one object; 0: anything."""


def rows(columns: Columns, at: Array) -> Columns:
    """Select rows by mask or index array."""
    return {name: column[at] for name, column in columns.items()}


def join_rows(columns: Columns, new: Columns) -> Columns:
    """Put rows of the same columns below these."""
    return {name: np.concatenate([column, new[name]]) for name, column in columns.items()}


def replace_rows(columns: Columns, at: Array, new: Columns) -> Columns:
    """Replace the rows `at` by those of `new`; texts get the room that the longest one needs."""
    result = {}
    for name, column in columns.items():
        is_text = column.dtype.kind == "U"
        result[name] = column.astype(np.result_type(column, new[name])) if is_text else column.copy()
        result[name][at] = new[name]
    return result


@dataclass(frozen=True, eq=False)
class Tracks:
    """T tracks in the order of their ids."""

    track_id: Int64  # (T,)
    hits: Int64  # (T,) how often it was measured
    missed: Int64  # (T,) steps with detection since it was measured last
    updated_ns: Int64  # (T,) stamp of the last measurement
    votes: Float64  # (T, labels) sum of the scores with which each label was detected
    states: States
    last: Columns  # (T,) the detection that measured each track last; carries what isn't filtered

    def __len__(self) -> int:
        return len(self.track_id)

    def select(self, which: Bool) -> "Tracks":
        """Tracks of a mask (T,)."""
        if which.all():
            return self
        at = np.flatnonzero(which)
        return Tracks(states=self.states.take(at, axis=1), last=rows(self.last, at), **rows(self._arrays, at))

    def labels(self) -> Text:
        """The label with the most votes (T,); of equals the first in `LABELS`, and `other` where there are none."""
        best = _LABELS[np.argmax(self.votes, axis=1)]
        return np.where(self.votes.any(axis=1), best, "other")

    def measure(self, at: Int64, detections: Columns, states: States, stamp_ns: int, sure: Bool) -> "Tracks":
        """Give the tracks `at` their detections and corrected states; the others have missed one more step. Only those
        that are `sure` count as hits.
        """
        hits, missed = self.hits.copy(), self.missed + 1
        updated_ns, votes = self.updated_ns.copy(), self.votes.copy()
        hits[at] += sure
        missed[at] = 0
        updated_ns[at] = stamp_ns
        votes[at] += count_votes(detections["label"], detections["score"])
        every = self.states.copy()
        every[:, at] = states
        last = replace_rows(self.last, at, detections)
        return Tracks(self.track_id, hits, missed, updated_ns, votes, every, last)

    def join(self, new: "Tracks") -> "Tracks":
        """Put other tracks behind these."""
        last, arrays = join_rows(self.last, new.last), join_rows(self._arrays, new._arrays)
        return Tracks(states=np.concatenate([self.states, new.states], axis=1), last=last, **arrays)

    @property
    def _arrays(self) -> Columns:
        return {name: getattr(self, name) for name in ("track_id", "hits", "missed", "updated_ns", "votes")}


def count_votes(label: Text, score: Float64) -> Float64:
    """One row of `Tracks.votes` a detection: its score at its label; `other` says nothing, so it has no vote."""
    votes = np.zeros((len(label), len(LABELS) + 1))
    column = [_LABEL.get(name, -1) for name in label.tolist()]
    votes[np.arange(len(label)), column] = np.where(score >= 0, score, _FAINT)
    return votes[:, :-1]


def are_rivals(a: Text, b: Text) -> Bool:
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


def sort_detections(detections: Columns, place: str) -> Columns:
    """Return sound detections by rising `place` (N, ...), equal ones by all that they carry. Those whose place, size,
    heading or score isn't finite are left out: nothing can be tracked by them.
    """
    if not len(detections[place]):
        return detections
    measured = [detections[name] for name in (place, "size_lwh_m", "yaw_rad", "score") if name in detections]
    sound = [np.abs(array).reshape(len(array), -1).max(axis=1) < MAX_MAGNITUDE for array in measured]
    good = np.asarray(np.logical_and.reduce(sound), np.bool_)
    detections = detections if good.all() else rows(detections, good)
    if len(detections[place]) < 2:
        return detections
    order = np.lexsort(detections[place].T[::-1])
    ordered = detections[place][order]
    if (ordered[1:] == ordered[:-1]).all(axis=1).any():
        keys = list[Array]()
        for _, array in sorted(detections.items()):
            keys += [array] if array.ndim == 1 else list(array.T)
        order = np.lexsort(keys)
    return rows(detections, order)
