"""The tracks that a tracker keeps: beginning, being measured, being missed, ending."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking.kalman import States
from fbench.replay.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data import LABELS, VEHICLES
from fbench.replay.errors import DataError

B = TypeVar("B", Boxes2D, Boxes3D)


@dataclass(frozen=True, eq=False)
class Tracks(Generic[B]):
    """T tracks in the order of their ids."""

    track_id: Int64
    """(T,)."""
    hits: Int64
    """(T,) how often it was measured."""
    missed: Int64
    """(T,) steps since it was measured last."""
    updated_ns: Int64
    """(T,) stamp of the last measurement."""
    votes: Float64
    """(T, labels) sum of the scores with which each label was detected."""
    states: States
    last: B
    """(T,) the detection that measured each track last; carries what isn't filtered."""

    def __len__(self) -> int:
        return len(self.track_id)

    def rows(self, rows: Array) -> "Tracks[B]":
        """Select tracks by mask or index array."""
        return Tracks(
            self.track_id[rows], self.hits[rows], self.missed[rows], self.updated_ns[rows], self.votes[rows],
            self.states.rows(rows), self.last[rows],
        )  # fmt: skip

    def labels(self) -> Text:
        """The label with the most votes (T,); of equals the first in `LABELS`, and `other` where nothing was said."""
        best = np.array(LABELS)[np.argmax(self.votes, axis=1)]
        return np.where(self.votes.any(axis=1), best, "other")


def first_tracks(detections: B, states: States, first_id: int, stamp_ns: int) -> Tracks[B]:
    """Begin one track a detection."""
    num = len(detections)
    return Tracks(
        first_id + np.arange(num), np.ones(num, np.int64), np.zeros(num, np.int64), np.full(num, stamp_ns, np.int64),
        ballots(detections), states, detections,
    )  # fmt: skip


def measured_tracks(tracks: Tracks[B], at: Int64, detections: B, states: States, stamp_ns: int) -> Tracks[B]:
    """Give the tracks `at` their detections and corrected states; the others have missed one more step."""
    hits, missed = tracks.hits.copy(), tracks.missed + 1
    updated_ns, votes = tracks.updated_ns.copy(), tracks.votes.copy()
    hits[at] += 1
    missed[at] = 0
    updated_ns[at] = stamp_ns
    votes[at] += ballots(detections)
    source = np.arange(len(tracks))
    source[at] = len(tracks) + np.arange(len(at))
    both = kalman.join(tracks.states, states).rows(source)
    return Tracks(
        tracks.track_id, hits, missed, updated_ns, votes, both, concatenate([tracks.last, detections])[source]
    )


def surviving(tracks: Tracks[B], min_hits: int, max_missed: int) -> Bool:
    """Which tracks go on (T,): measured now, or confirmed by `min_hits` and missed at most `max_missed` times."""
    going_on: Bool = (tracks.missed == 0) | ((tracks.hits >= min_hits) & (tracks.missed <= max_missed))
    return going_on


def joined(first: Tracks[B], second: Tracks[B]) -> Tracks[B]:
    """Put two sets of tracks into one."""
    return Tracks(
        np.concatenate([first.track_id, second.track_id]),
        np.concatenate([first.hits, second.hits]),
        np.concatenate([first.missed, second.missed]),
        np.concatenate([first.updated_ns, second.updated_ns]),
        np.concatenate([first.votes, second.votes]),
        kalman.join(first.states, second.states),
        concatenate([first.last, second.last]),
    )


def ballots(detections: B) -> Float64:
    """One row of `Tracks.votes` a detection: its score at its label; `other` says nothing, so it has no vote."""
    votes = np.zeros((len(detections), len(LABELS)))
    if detections.label is not None and detections.score is not None:
        votes += (detections.label[:, None] == np.array(LABELS)) * detections.score[:, None]
    votes[:, LABELS.index("other")] = 0.0
    return votes


def rivals(a: Text | None, b: Text | None, shape: tuple[int, int]) -> Bool:
    """Which labels (N,) and (M,) can't be one object: car and van can, car and pedestrian not; `other` is anything."""
    if a is None or b is None:
        return np.zeros(shape, bool)
    first, second = (np.where(np.isin(x, VEHICLES), "vehicle", x) for x in (a, b))
    known = (first != "other")[:, None] & (second != "other")[None, :]
    different: Bool = known & (first[:, None] != second[None, :])
    return different


def seconds_since(last_ns: int, stamp_ns: int) -> float:
    """Time step of a filter [s].

    Raises:
        DataError: where time doesn't go forward.
    """
    if stamp_ns <= last_ns:
        raise DataError(f"tracker: stamp {stamp_ns} isn't after {last_ns}, reset trackers where a segment begins")
    return (stamp_ns - last_ns) * 1e-9
