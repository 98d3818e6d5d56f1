"""Events of a run as slices of its scores."""

from collections.abc import Mapping
from collections.abc import Sequence as AbstractSequence
from dataclasses import replace

import numpy as np

from fbench.metrics.core.slices import VEHICLE, Group, ScoreKey, find_labels, label_group
from fbench.metrics.criticality.metric import judge_side
from fbench.metrics.criticality.motion import EgoMotion, find_ego_motion
from fbench.metrics.events.finder import BY_SIGHT, EVENTS, Found, find_events
from fbench.metrics.events.scores import (
    SLICE,
    ArrivalCounts,
    EventCounts,
    arrival_rows,
    compare_steps,
    count_arrivals,
    count_stretches,
    event_rows,
    temporal_hota,
    value_of,
)
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.places import once
from fbench.metrics.runs.spaces import ground_view, image_view
from fbench.metrics.runs.tracking import NO_TRACKS
from fbench.metrics.tracking.scores import follow_tracks
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

IN_IMAGES = "results are in images; events need 3D boxes"
_ROAD_USERS = ("bicycle", "pedestrian")  # Beside vehicles, classes of their own where the pipeline knows classes


class Events:
    """How a pipeline does in cut-ins and other events of traffic, as slices `event:cut-in` ...

    The rules are in `fbench.metrics.events.finder`. They need poses, and velocities or ids of truth. `recall` is that
    of detections and `clr_re` that of tracks over the truth boxes in an event. The same rules find events in tracks:
    `hota_temporal` is HOTA of the boxes that are in the event on either side, and `timestamp_balanced_accuracy` the
    mean share of frames, with and without the event, of which tracks say the same, as in the scenario mining of
    Argoverse 2 (av2-api 0.3.6), with fbench's events instead of described ones, without tuned score thresholds.
    """

    def scores(self, run: Run, options: ScoreOptions) -> AbstractSequence[Score]:
        """Return rows of all vehicles, and of labels that occur in an event; null with the reason where motion isn't
        known.
        """
        is_solid = isinstance(run.detections.boxes, Boxes3D)
        view = ground_view(run, run.detections, options) if is_solid else image_view(run, run.detections, options)
        key = view.key
        if not is_solid:
            key = replace(key, reason=key.reason or IN_IMAGES)
        if key.reason:
            rows = [row for name in EVENTS for row in event_rows(EventCounts(), _slice(key, name), False, False)]
            return [*rows, *_arrivals(run, options, None, VEHICLE, key)]
        ego = once(run, "ego motion", lambda: find_ego_motion(run))
        found = once(run, ("events", options), lambda: find_events(view.sequence.truth, view.sequence.steps, ego))
        tracked = None
        if run.manifest.has_tracks:
            own = ground_view(run, run.tracks, options)
            tracked = own, find_events(own.sequence.estimates, own.sequence.steps, ego, is_truth=False)
        rows = []
        for group in _groups(run, view):
            rows += _rows(run, options, view, found, tracked, ego, group)
            of_tracks = None if tracked is None else (tracked[0], found)
            rows += _arrivals(run, options, of_tracks, group, replace(view.key, class_=group.name))
        return rows

    def value_of(self, metric: str, counts: Mapping[str, int | float]) -> float | None:
        """Return the value of a row from its counts, added over runs; `None` where it is undefined."""
        return value_of(metric, counts)[0]


def _slice(key: ScoreKey, event: str) -> ScoreKey:
    return replace(key, slice=f"{SLICE}{event}")


def _groups(run: Run, view: View) -> list[Group]:
    met = find_labels(view.sequence.truth, view.sequence.estimates)
    known = [] if run.detections.boxes.label is None else [name for name in _ROAD_USERS if name in met]
    return [VEHICLE, *map(label_group, known)]


def _rows(
    run: Run, options: ScoreOptions, view: View, found: Found, tracked: tuple[View, Found] | None, ego: EgoMotion,
    group: Group,
) -> list[Score]:  # fmt: skip
    """Rows of all events of one class; vehicles alone cut in, brake, come toward the ego and stand in its lane."""
    truth, steps = view.sequence.truth, view.sequence.steps
    known = np.isfinite(ego.of_frames(steps.frame).velocity)
    counted, rows = group.counts(truth), []
    for name in EVENTS if group is VEHICLE else ("crossing", *BY_SIGHT):
        head, by_sight = replace(_slice(view.key, name), class_=group.name), name in BY_SIGHT
        if (why := found.unknown(name, bool(known.any()))) is not None:
            head, n = replace(head, reason=why), EventCounts()
        else:
            n = _count_event(run, options, view, np.flatnonzero(found.rows[name] & counted), group)
            if tracked is not None:
                own = np.flatnonzero(found.rows[name] & counted)
                n = _count_tracks(run, options, tracked, n, own, known, group, name)
        rows += event_rows(n, head, by_sight, tracked is not None)
    return rows


def _count_event(run: Run, options: ScoreOptions, view: View, own: Int64, group: Group) -> EventCounts:
    """How detections find the truth of an event, by its rows."""
    if not len(own):
        return EventCounts()
    errors = judge_side(run, options, "detections", view, group)
    hits = int(errors.hit[np.isin(errors.truth_row, own)].sum())
    return EventCounts(count_stretches(view.sequence.truth, own, view.sequence.steps), hits, len(own) - hits)


def _count_tracks(
    run: Run, options: ScoreOptions, tracked: tuple[View, Found], n: EventCounts, own: Int64, known: Bool,
    group: Group, name: str,
) -> EventCounts:  # fmt: skip
    """Add how tracks find the truth of an event, by its rows, and whether they show the same event at the steps (S,) at
    which the ego's motion is known.
    """
    view, shown = tracked
    truth, tracks, steps = view.sequence.truth, view.sequence.estimates, view.sequence.steps
    errors = judge_side(run, options, "tracks", view, group)
    if len(own):
        hits = int(errors.hit[np.isin(errors.truth_row, own)].sum())
        n = replace(n, tracked=hits, untracked=len(own) - hits)
    if name in BY_SIGHT:
        return n
    # Tracks on truth that doesn't count, or outside the region without a partner in it, show no false event.
    judged = np.zeros(len(tracks), bool)
    judged[np.concatenate([errors.pairs[1], errors.alarm_row])] = True
    held = shown.rows[name] & judged
    hota = temporal_hota(truth[own], tracks[held], steps, view.match) if len(own) or held.any() else n.hota
    return replace(n, steps=compare_steps(truth.step[own], tracks.step[held], known), hota=hota)


def _arrivals(
    run: Run, options: ScoreOptions, tracked: tuple[View, Found] | None, group: Group, key: ScoreKey
) -> list[Score]:
    """Rows of the time from first sight to a stable track; `tracked` is the view of tracks, and the events of truth."""
    if key.reason or tracked is None:
        return arrival_rows(ArrivalCounts(), key, key.reason or NO_TRACKS) if group is VEHICLE else []
    view, found = tracked
    if found.visible is None:
        why = found.unknown(BY_SIGHT[0], has_ego=True)
        return arrival_rows(ArrivalCounts(), key, why) if group is VEHICLE else []
    _, problem, pairs = follow_tracks(view.sequence, group, view.match)
    ids = np.append(problem.estimate_id, -1)[pairs.estimate_of]
    return arrival_rows(count_arrivals(view.sequence, found.first_seen, problem.truth_row, ids), key, None)
