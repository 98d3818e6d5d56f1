"""Rules by which events are found from motions, paths and visibility."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fbench.metrics.criticality.motion import EGO_UNKNOWN, EgoMotion, Motion, move_ego, move_objects
from fbench.metrics.events.paths import PathPlaces, place_on_paths
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.sequences import Objects, Steps

EVENTS = ("cut-in", "crossing", "hard braking", "stopped behind", "oncoming", "occluded then visible",
          "first seen at distance")  # fmt: skip
BY_SIGHT = EVENTS[-2:]  # These need to know what can be seen; the others need motions
_BY_CHANGE = ("cut-in", "hard braking")  # These need more than one instant of an object, so ids
_MOVING_MPS = 2.0  # From this speed on, vehicles and the ego move
_STANDING_MPS = 0.5
_ALONG_RAD, _AGAINST_RAD = np.pi / 4, 3 * np.pi / 4  # Courses against the path: along up to, toward the ego from
_LANE_M = 1.75  # Up to so far aside, a center is in the ego's lane
_CUT_FROM_M, _CUT_AHEAD_M, _CUT_S, _CUT_AFTER_S = 2.5, 40.0, 4.0, 1.0
_CROSS_AHEAD_M, _CROSS_S = 40.0, 3.0
_BRAKE_MPS2, _BRAKE_FROM_MPS, _BRAKE_AHEAD_M = 3.0, 1.0, 60.0
_QUEUE_M = 15.0
_ONCOMING_AHEAD_M, _ONCOMING_ASIDE_M = 60.0, 6.0
_SEEN, _HIDDEN = 0.4, 0.2  # Visible share from which on an object is seen, and below which it is hidden
_SEEN_POINTS = 5  # The same by points where truth has no visible share; hidden is without any
_HIDDEN_S, _APPEARED_S, _FAR_M = 0.5, 2.0, 30.0


@dataclass(frozen=True, eq=False)
class Found:
    """Events of N boxes of one side."""

    rows: Mapping[str, Bool]  # (N,) which boxes are in each event, by `EVENTS`
    known: Bool  # (N,) whether place and motion are known
    visible: Bool | None  # (N,) whether an object is seen; `None`: nobody tells
    first_seen: Int64  # Rows (K,) at which objects are seen first, of those that weren't seen from the beginning
    has_ids: bool  # Whether any box has one

    def unknown(self, event: str, has_ego: bool) -> str | None:
        """Say why nothing can be said about an event; `None` where something can."""
        if event in BY_SIGHT:
            return "truth has neither visibility nor point counts with ids" if self.visible is None else None
        if not has_ego:
            return EGO_UNKNOWN
        if len(self.known) and not self.known.any():
            return "truth has no velocities, nor ids to derive them from"
        if event in _BY_CHANGE and len(self.known) and not self.has_ids:
            return f"truth has no ids, which {event} takes"
        return None


def find_events(objects: Objects, steps: Steps, ego: EgoMotion, is_truth: bool = True) -> Found:
    """Find the events of truth, or of tracks, whose velocities count as those of truth.

    A path is the one that the ego then drives. Vehicles move from 2 m/s on and stand below 0.5 m/s. A vehicle is in the
    ego's lane up to 1.75 m from the path, goes along up to 45 deg, and toward the ego from 135 deg.

    - cut-in: a moving vehicle that goes along comes from 2.5 m or more beside the path into the lane of the moving ego
      within 4 s, up to 40 m ahead. The event lasts until 1 s after it came in.
    - crossing: a road user from 0.5 m/s on, with a course of 45 to 135 deg, up to 40 m ahead, that is in the lane or
      will be at the path's middle within 3 s at its speed.
    - hard braking: a vehicle of 1 m/s or more in the lane, along, up to 60 m ahead, brakes with 3 m/s^2 or more.
    - stopped behind: ego and vehicle stand, and the vehicle heads along in the lane up to 15 m ahead.
    - oncoming: a moving vehicle goes toward the ego, up to 60 m ahead and up to 6 m beside the path.
    - occluded then visible: an object is seen (40 % of it) that was hidden (below 20 %) and not seen for 0.5 s or more;
      2 s from then on. Where truth has no visible share, 5 points and none stand for that.
    - first seen at distance: an object is seen for the first time 30 m or more away, and 2 s from then on. What is seen
      in the first frame doesn't count, because nobody knows when it was seen first.
    """
    own = ego.of_frames(steps.frame)
    bodies = move_objects(objects, steps, ego, else_standing=not is_truth)
    places = place_on_paths(bodies, objects.step, steps, own)
    ego_mps = move_ego(ego, steps).speed_mps[objects.step]
    known = bodies.known & np.isfinite(places.ahead_m) & np.isfinite(ego_mps)
    tracks = list(_tracks(objects, steps))
    time_s = (steps.stamp_ns - steps.stamp_ns[:1].sum())[objects.step] * 1e-9
    with np.errstate(invalid="ignore"):
        rows = _of_instants(objects, bodies, places, ego_mps)
        rows["cut-in"] = _cut_ins(tracks, time_s, objects, bodies, places, ego_mps)
    visible, hidden = _sight(objects)
    first, nobody = np.zeros(0, np.int64), np.zeros(len(objects), bool)
    rows |= dict.fromkeys(BY_SIGHT, nobody)
    if visible is not None and hidden is not None:
        first = _first_seen(tracks, visible, objects, steps)
        rows["first seen at distance"] = _far_first(tracks, first, time_s, objects)
        rows["occluded then visible"] = _find_reappearing(tracks, visible, hidden, time_s, steps.places[objects.step])
    return Found({name: rows[name] for name in EVENTS}, known, visible, first, bool((objects.track_id >= 0).any()))


def _is_vehicle(objects: Objects) -> Bool:
    return np.isin(objects.label, (*VEHICLES, ""))


def _of_instants(objects: Objects, bodies: Motion, p: PathPlaces, ego_mps: Float64) -> dict[str, Bool]:
    """Events that need no history."""
    vehicle, speed, course = _is_vehicle(objects), bodies.speed_mps, np.abs(p.course_rad)
    in_lane, ahead = np.abs(p.aside_m) <= _LANE_M, p.ahead_m > 0
    across_mps = speed * np.sin(p.course_rad)
    reaches = (p.aside_m * across_mps < 0) & (np.abs(p.aside_m) <= _CROSS_S * np.abs(across_mps) + 1e-9)
    brakes = (bodies.acceleration_mps2 <= -_BRAKE_MPS2) & (speed >= _BRAKE_FROM_MPS) & (course <= _ALONG_RAD)
    stand = (speed < _STANDING_MPS) & (ego_mps < _STANDING_MPS) & (np.abs(p.heading_rad) <= _ALONG_RAD)
    crosses = (speed >= _STANDING_MPS) & (course > _ALONG_RAD) & (course < _AGAINST_RAD) & (in_lane | reaches)
    comes = vehicle & (speed >= _MOVING_MPS) & (course >= _AGAINST_RAD) & (np.abs(p.aside_m) <= _ONCOMING_ASIDE_M)
    return {
        "crossing": crosses & ahead & (p.ahead_m <= _CROSS_AHEAD_M),
        "hard braking": vehicle & brakes & in_lane & ahead & (p.ahead_m <= _BRAKE_AHEAD_M),
        "stopped behind": vehicle & stand & in_lane & ahead & (p.ahead_m <= _QUEUE_M),
        "oncoming": comes & ahead & (p.ahead_m <= _ONCOMING_AHEAD_M),
    }


def _tracks(objects: Objects, steps: Steps) -> Iterator[Int64]:
    """Yield the rows of each object with an id, in the order of time, within a stream."""
    named = np.flatnonzero(objects.track_id >= 0)
    keys = steps.places[objects.step[named]], objects.track_id[named], steps.stream[objects.step[named]]
    order = named[np.lexsort(keys)]
    stream, number = steps.stream[objects.step[order]], objects.track_id[order]
    if len(order):
        yield from np.split(order, np.flatnonzero((np.diff(number) != 0) | (np.diff(stream) != 0)) + 1)


def _cut_ins(
    tracks: list[Int64], time_s: Float64, objects: Objects, bodies: Motion, p: PathPlaces, ego_mps: Float64
) -> Bool:
    found = np.zeros(len(objects), bool)
    aside = np.abs(p.aside_m)
    fits = _is_vehicle(objects) & (bodies.speed_mps >= _MOVING_MPS) & (np.abs(p.course_rad) <= _ALONG_RAD)
    fits &= (p.ahead_m > 0) & (p.ahead_m <= _CUT_AHEAD_M) & (ego_mps >= _MOVING_MPS) & (aside <= _LANE_M)
    for track in tracks:
        if not fits[track].any() or aside[track].max(initial=0.0) < _CUT_FROM_M:
            continue
        t, inside, outside = time_s[track], aside[track] <= _LANE_M, aside[track] >= _CUT_FROM_M
        for i in np.flatnonzero(inside[1:] & ~inside[:-1]) + 1:
            before = np.flatnonzero(outside[:i] & (t[:i] >= t[i] - _CUT_S - 1e-9))
            if len(before) and fits[track[i]]:
                found[track[before[-1] :][t[before[-1] :] <= t[i] + _CUT_AFTER_S + 1e-9]] = True
    return found


def _sight(objects: Objects) -> tuple[Bool | None, Bool | None]:
    """Which boxes (N,) are seen, and which are hidden; `None` where nobody tells, or nothing has an id."""
    if not (objects.track_id >= 0).any():
        return None, None
    share = objects.visibility
    if share is not None and np.isfinite(share).any():
        return share >= _SEEN, share < _HIDDEN
    if objects.num_points is not None and (objects.num_points >= 0).any():
        return objects.num_points >= _SEEN_POINTS, objects.num_points == 0
    return None, None


def _first_seen(tracks: list[Int64], visible: Bool, objects: Objects, steps: Steps) -> Int64:
    """Rows (K,) at which objects are seen first, ascending; without those that are seen in the first step of all."""
    rows = [int(track[np.argmax(visible[track])]) for track in tracks if visible[track].any()]
    first = np.array(sorted(rows), np.int64)
    return first[steps.places[objects.step[first]] > 0]


def _far_first(tracks: list[Int64], first: Int64, time_s: Float64, objects: Objects) -> Bool:
    found, center = np.zeros(len(objects), bool), objects.center_m
    if center is not None:
        far = set(first[np.hypot(center[first, 0], center[first, 1]) >= _FAR_M].tolist())
        for track in tracks:
            for i in far.intersection(track.tolist()):
                found[track[(time_s[track] >= time_s[i]) & (time_s[track] <= time_s[i] + _APPEARED_S + 1e-9)]] = True
    return found


def _find_reappearing(tracks: list[Int64], visible: Bool, hidden: Bool, time_s: Float64, place: Int64) -> Bool:
    found = np.zeros(len(visible), bool)
    for track in tracks:
        seen, dark, t = visible[track], hidden[track], time_s[track]
        if not (seen.any() and dark.any()):
            continue
        whole = np.diff(place[track], prepend=place[track[0]] - 1) == 1
        since: int | None = None  # Since when it is hidden
        for i in range(len(track)):
            if not whole[i]:
                since = None
            if seen[i]:
                if since is not None and t[i] - t[since] >= _HIDDEN_S - 1e-9:
                    found[track[i:][t[i:] <= t[i] + _APPEARED_S + 1e-9]] = True
                since = None
            elif dark[i] and since is None:
                since = i
    return found
