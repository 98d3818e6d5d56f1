"""Tracks: how they are born, measured, missed, shown and ended, in images and in space alike."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking.association import associate_weak_last
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.params import TrackerParams
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import LABELS, MAX_MAGNITUDE, VEHICLES, Boxes2D, Boxes3D

Columns: TypeAlias = dict[str, Array]  # Arrays (T, ...) by name, all with equally many rows
B = TypeVar("B", bound=Boxes2D | Boxes3D)

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
        return Tracks(states=self.states.rows(at), last=rows(self.last, at), **rows(self._arrays, at))

    def labels(self) -> Text:
        """The label with the most votes (T,); of equals the first in `LABELS`, and `other` where there are none."""
        best = _LABELS[np.argmax(self.votes, axis=1)]
        return np.where(self.votes.any(axis=1), best, "other")

    def measure(self, at: Int64, detections: Columns, states: States, stamp_ns: int) -> "Tracks":
        """Give the tracks `at` their detections and corrected states; the others have missed one more step."""
        hits, missed = self.hits.copy(), self.missed + 1
        updated_ns, votes = self.updated_ns.copy(), self.votes.copy()
        hits[at] += 1
        missed[at] = 0
        updated_ns[at] = stamp_ns
        votes[at] += count_votes(detections["label"], detections["score"])
        last = replace_rows(self.last, at, detections)
        return Tracks(self.track_id, hits, missed, updated_ns, votes, self.states.replace_rows(at, states), last)

    def join(self, new: "Tracks") -> "Tracks":
        """Put other tracks behind these."""
        last, arrays = join_rows(self.last, new.last), join_rows(self._arrays, new._arrays)
        return Tracks(states=kalman.join(self.states, new.states), last=last, **arrays)

    @property
    def _arrays(self) -> Columns:
        return {name: getattr(self, name) for name in ("track_id", "hits", "missed", "updated_ns", "votes")}


class Tracker(ABC, Generic[B]):
    """Kalman filters with constant velocity, one a track; subclasses know what is measured and what fits.

    A step predicts all tracks, pairs them with detections and corrects those that got one. Tracks that were missed too
    often end. Every detection that is left, unless its score is weak, is the birth of a track: see `_begin`.

    Ids go by the order of detections in which tracks begin; with `any_order` detections are sorted by their content
    first, and those that aren't finite are left out.
    """

    kind: type[B]  # Of boxes
    place: str  # Name of the column that says where a detection is
    carries: tuple[str, ...]  # Names of all columns

    def __init__(self, common: TrackerParams, any_order: bool) -> None:
        self._common, self._any_order = common, any_order
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks | None = None
        self._stamp_ns = self._steps = 0
        self._with_label = False

    def step(self, boxes: B, stamp_ns: int, world_T_body: Float64 | None = None) -> B:
        """Take the detections at `stamp_ns`; returns the tracks, also those only predicted, in the same coordinates.

        Fields of the result are the same in every step; `label` is there where the detections have it. The pose counts
        in space alone. Raises DataError where `stamp_ns` isn't later than at the last step since the reset.
        """
        pose = self._take_pose(stamp_ns, world_T_body)
        detections = self._columns(boxes)
        if self._any_order:
            detections = sort_detections(detections, self.place)
        if pose is not None:
            detections = self._move(detections, pose)
        weak = np.asarray(detections["score"] < self._common.weak_score, np.bool_)
        if self._tracks is None:
            self._tracks = self._begin(rows(detections, ~weak), stamp_ns)
        else:
            self._tracks = self._follow(self._advance(self._tracks, stamp_ns), detections, weak, stamp_ns)
        self._stamp_ns, self._steps = stamp_ns, self._steps + 1
        self._with_label = boxes.label is not None or (not len(boxes) and self._with_label)
        return self._report(self._tracks, pose)

    def predict(self, stamp_ns: int, world_T_body: Float64 | None = None) -> B:
        """Return tracks at an instant without detection, so that none missed anything. Raises DataError: see `step`."""
        pose = self._take_pose(stamp_ns, world_T_body)
        if self._tracks is None:
            return self._report(self._begin(self._columns(self.kind.empty()), stamp_ns), pose)
        self._tracks = self._advance(self._tracks, stamp_ns)
        self._stamp_ns = stamp_ns
        return self._report(self._tracks, pose)

    def _begin(self, detections: Columns, stamp_ns: int) -> Tracks:
        num, first_id = len(detections["score"]), self._next_id
        self._next_id += num
        return Tracks(
            track_id=first_id + np.arange(num),
            hits=np.ones(num, np.int64),
            missed=np.zeros(num, np.int64),
            updated_ns=np.full(num, stamp_ns, np.int64),
            votes=count_votes(detections["label"], detections["score"]),
            states=self._first_states(detections),
            last=detections,
        )

    def _follow(self, tracks: Tracks, detections: Columns, weak: Bool, stamp_ns: int) -> Tracks:
        similarity, least = self._similarity(tracks, detections, stamp_ns)
        similarity[are_rivals(tracks.last["label"], detections["label"])] = 0.0
        at, columns = associate_weak_last(similarity, least, weak)
        found = rows(detections, columns)
        states = kalman.update(tracks.states.rows(at), *self._measure(found))
        tracks = tracks.measure(at, self._carry(tracks, at, found), states, stamp_ns)
        is_confirmed = (tracks.hits >= self._common.min_hits) & (tracks.missed <= self._common.max_missed)
        alive = tracks.select((tracks.missed == 0) | is_confirmed)
        new = ~weak
        new[columns] = False
        return alive.join(self._begin(rows(detections, new), stamp_ns)) if new.any() else alive

    def _advance(self, tracks: Tracks, stamp_ns: int) -> Tracks:
        if stamp_ns <= self._stamp_ns:
            raise DataError(
                f"tracker: stamp {stamp_ns} isn't after {self._stamp_ns}, reset trackers where a segment begins"
            )
        return self._predict(tracks, (stamp_ns - self._stamp_ns) * 1e-9)

    def _report(self, tracks: Tracks, pose: Float64 | None) -> B:
        """Boxes of confirmed tracks that weren't missed too often or for too long; early on fewer hits are enough."""
        p = self._common
        coasted_s = (self._stamp_ns - tracks.updated_ns) * 1e-9
        is_confirmed = tracks.hits >= min(p.min_hits, self._steps)
        is_proven = tracks.hits >= tracks.missed * p.hits_per_missed
        is_recent = (tracks.missed <= p.max_missed_shown) & (coasted_s <= p.max_coast_s)
        tracks = tracks.select(is_confirmed & is_proven & is_recent)
        predicted = np.asarray(tracks.updated_ns < self._stamp_ns, np.bool_)
        found: Columns = tracks.last | {
            "score": lower_predicted(tracks.last["score"], predicted, p.predicted_share),
            "track_id": tracks.track_id,
            "predicted": predicted,
            "label": tracks.labels(),
        }
        if not self._with_label:
            del found["label"]
        return self._boxes(found, tracks.states, pose)

    def _take_pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        """Pose to track by; `None`: in the coordinates of the detections."""
        return None

    def _move(self, detections: Columns, dst_T_src: Float64) -> Columns:
        return detections

    def _columns(self, boxes: Boxes2D | Boxes3D) -> Columns:
        """The fields that tracks carry, present in any case."""
        num, columns = len(boxes), dict[str, Array]()
        unknown: Columns = {
            "label": np.full(num, "other"),
            "score": np.ones(num),
            "sources": np.zeros(num, np.uint8),
            "velocity_mps": np.full((num, 3), np.nan),
        }
        for name in self.carries:
            array = getattr(boxes, name)
            columns[name] = unknown.get(name, np.full(num, np.nan)) if array is None else array
        return columns

    @abstractmethod
    def _first_states(self, detections: Columns) -> States: ...

    @abstractmethod
    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        """What the filters measure of detections (N, m), and its standard deviation."""

    @abstractmethod
    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks: ...

    @abstractmethod
    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        """How well tracks and detections fit (T, M), whatever their labels, and how well a pair must."""

    @abstractmethod
    def _carry(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        """What the tracks `at` carry on from the detections that measured them."""

    @abstractmethod
    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> B: ...


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


def newest_share(hits: Int64, least: float) -> Float64:
    """Share (T,) of the newest of `hits` measurements in their mean: one of all at first, and never below `least`. With
    0 the mean is that of all measurements, with 1 it is the last one.
    """
    return np.maximum(1.0 / hits, least)


def mean_of(before: Float64, now: Float64, share: Float64) -> Float64:
    """Mean of what was (T, ...) and a new measurement with its share (T,)."""
    share = share.reshape(share.shape + (1,) * (now.ndim - 1))
    return before + share * (now - before)


def lower_predicted(score: Float64, predicted: Bool, share: float) -> Float64:
    """Scores (T,), those of predicted tracks lowered to a share; negative ones, which are no probabilities, stay."""
    return score if share == 1.0 else np.where(predicted & (score > 0), score * share, score)


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
