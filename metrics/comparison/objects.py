"""Changes between two runs, object by object, and where their outputs differ first."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from fbench.metrics.comparison.cells import CellPair
from fbench.metrics.comparison.counts import options_of
from fbench.metrics.core.slices import VEHICLE
from fbench.metrics.detection.outcomes import Judgement, Outcome, compare_class, judge_detections
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.scores import follow_tracks
from fbench.replay.check.difference import boxes_difference
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Source
from fbench.replay.data.comparison import Divergence, ObjectChange, WorstFrame
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.data.sequences import Objects
from fbench.replay.runs.folder import FrameRecord, Run

_NAMES = {Source.C: "camera", Source.L: "lidar", Source.R: "radar", Source.S: "stereo"}
_GAP = 2  # Frames that a stretch may skip
_NEAR = 3.0  # How many times the threshold a detection may be off and still be worth a word
Kind: TypeAlias = Literal["LOST", "FOUND", "NEW FALSE ALARM", "NEW SWITCH"]
Place: TypeAlias = tuple[float, tuple[float, float] | None]
"""Distance in the ground plane [m], NaN where unknown; and x, y in body coordinates [m], `None` in images."""


def name_sensors(sources: int) -> str:
    """Return the kinds of sensors of a bit mask, `camera+lidar`; empty where unknown."""
    return "+".join(name for bit, name in _NAMES.items() if sources & bit.value)


@dataclass(frozen=True)
class Event:
    """One box in one frame that only one side has, or a switch."""

    kind: Kind
    identity: int  # Of truth, or of the head's track
    label: str
    camera: str
    frame: int
    place: Place
    why: str


def place_of(objects: Objects, row: int) -> Place:
    """Return where an object is."""
    if objects.center_m is not None:
        x, y = objects.center_m[row, :2].tolist()
        return float(np.hypot(x, y)), (x, y)
    return (np.nan if objects.distance_m is None else float(objects.distance_m[row])), None


class _Side:
    """One run judged: detections against truth, and its tracks."""

    def __init__(self, run: Run, options: ScoreOptions) -> None:
        self.run = SharedRun(run.folder)
        view = views(self.run, self.run.detections, options)[0]
        self.judged: Judgement = judge_detections(compare_class(view.sequence, VEHICLE, view.match))
        self.sequence, self.match = view.sequence, view.match
        tracks = views(self.run, self.run.tracks, options)[0]
        has_tracks = run.manifest.has_tracks and tracks.key.reason is None
        self.followed = follow_tracks(tracks.sequence, VEHICLE, tracks.match) if has_tracks else None
        self.tracks = tracks.sequence
        self.records = {frame.index: frame for frame in run.frames}
        c = self.judged.candidates
        self.found = np.full(len(c.truth_row), -1, np.int64)  # Which estimate is on each truth box
        hits = np.flatnonzero(self.judged.truth_of_estimate >= 0)
        self.found[self.judged.truth_of_estimate[hits]] = hits
        # By instant, camera, id and place, as nothing else names a box of truth in both runs.
        frame = c.sequence.steps.stamp_ns[c.truth.step].tolist()
        camera = [c.sequence.steps.camera[s] if c.sequence.steps.camera else "" for s in c.truth.step.tolist()]
        number: dict[tuple[int, str, int], int] = {}
        self.keys: dict[tuple[int, str, int, int], int] = {}
        for n, (f, cam, identity) in enumerate(zip(frame, camera, c.truth.track_id.tolist(), strict=True)):
            place = number[f, cam, identity] = number.get((f, cam, identity), -1) + 1
            self.keys[f, cam, identity, place] = n

    def sources(self, estimate: int) -> str:
        """Kinds of sensors that had a part in an estimate."""
        held = self.judged.candidates.estimates.sources
        return "" if held is None else name_sensors(int(held[estimate]))

    def frame(self, n: int) -> int:
        """Index of the frame of the n-th truth box."""
        c = self.judged.candidates
        return int(c.sequence.steps.frame[c.truth.step[n]])

    def explain_miss(self, n: int) -> str:
        """Say why the n-th truth box wasn't found, and how far the nearest estimate was off."""
        record, c = self.records.get(self.frame(n)), self.judged.candidates
        if record is not None and record.failed:
            return "the pipeline failed"
        gone = [f"no {name} ({why.partition(' by ')[0]})" for name, why in (record.missing if record else {}).items()]
        step = int(c.truth.step[n])
        values = c.similarity.block(step)[n - int(c.similarity.row_start[step])]
        if values.size and np.isfinite(values).any():
            best = int(np.nanargmax(values))
            near, estimate = float(values[best]), best + int(c.similarity.column_start[step])
            if near >= c.match.floor:
                gone.append("the nearest detection is on another")
            elif not c.match.is_distance or -near < _NEAR * c.match.threshold:
                seen = self.sources(estimate)
                off = f"{-near:.1f} m off" if c.match.is_distance else f"overlap {near:.2f}"
                gone.append(f"nearest{f' by {seen}' if seen else ''} is {off}")
        return ", ".join(gone) or "nothing near"


def find_changes(pair: CellPair, most: int = 50) -> tuple[list[ObjectChange], list[WorstFrame]]:
    """Return the objects that only one side has, most frames first, and the frames with most new errors."""
    if pair.is_identical or pair.base.run is None or pair.head.run is None:
        return [], []
    options = options_of(pair.base.scores)
    base, head = (_Side(side.run, options) for side in (pair.base, pair.head) if side.run is not None)
    events = [*_misses(base, head), *_alarms(base, head), *_switches(base, head)]
    changes = sorted(join_events(events, str(pair.name), head.records), key=lambda c: (-c.num_frames, c.from_s, str(c)))
    return changes[:most], _worst(pair, head.records)


def _misses(base: _Side, head: _Side) -> Iterator[Event]:
    """Yield truth boxes that one side found and the other didn't."""
    c = base.judged.candidates
    for key, n in base.keys.items():
        m = head.keys.get(key)
        if m is None or (base.found[n] >= 0) == (head.found[m] >= 0):
            continue
        is_lost = bool(base.found[n] >= 0)
        one, other, at = (base, head, m) if is_lost else (head, base, n)
        had = one.sources(int(base.found[n] if is_lost else head.found[m]))
        missed = other.explain_miss(at)
        sensors = f"{had} had it" if had else f"{'base' if is_lost else 'head'} had it"
        kind: Kind = "LOST" if is_lost else "FOUND"
        place, why = place_of(c.truth, n), f"{missed}; {sensors}"
        yield Event(kind, key[2], str(c.truth.label[n]), key[1], head.frame(m), place, why)


def _alarms(base: _Side, head: _Side) -> Iterator[Event]:
    """Yield false alarms of the head with none of the base near them."""
    old: dict[int, list[Float64]] = {}
    for frame, xy, _ in _false(base):
        old.setdefault(base.records[frame].stamp_ns, []).append(xy)
    number, before = 0, dict[int, list[tuple[Float64, int]]]()
    for frame, xy, m in _false(head):
        if any(
            np.hypot(*(xy - other)) <= 2 * base.match.threshold for other in old.get(head.records[frame].stamp_ns, [])
        ):
            continue
        # The same alarm as a frame ago where it is near; a road user moves a few meters at most.
        near = [(float(np.hypot(*(xy - o))), own) for o, own in before.get(frame - 1, []) if np.hypot(*(xy - o)) < 4.0]
        identity = min(near)[1] if near else number
        number += not near
        before.setdefault(frame, []).append((xy, identity))
        e, seen = head.judged.candidates.estimates, head.sources(m)
        why = f"by {seen}" if seen else "base had none there"
        yield Event("NEW FALSE ALARM", identity, str(e.label[m]), "", frame, place_of(e, m), why)


def _false(side: _Side) -> Iterator[tuple[int, Float64, int]]:
    """Frame, place and number of each false alarm, in the order of frames."""
    c = side.judged.candidates
    rows = np.flatnonzero(np.isin(side.judged.outcome, (Outcome.FALSE_ALARM, Outcome.INVALID)))
    if c.estimates.center_m is None or not c.match.is_distance:
        return  # In images places of different frames say little
    for m in rows.tolist():
        yield int(c.sequence.steps.frame[c.estimates.step[m]]), c.estimates.center_m[m, :2], m


def _switches(base: _Side, head: _Side) -> Iterator[Event]:
    """Yield switches of identity that the base hasn't."""
    old = {(base.records[frame].stamp_ns, *rest) for (frame, *rest), _ in _find_switches(base)}
    for (frame, identity, camera), row in _find_switches(head):
        if (head.records[frame].stamp_ns, identity, camera) not in old and head.followed is not None:
            truth = head.followed[0].candidates.truth
            place, label = place_of(truth, row), str(truth.label[row])
            yield Event("NEW SWITCH", identity, label, camera, frame, place, "base kept its track")


def _find_switches(side: _Side) -> Iterator[tuple[tuple[int, int, str], int]]:
    if side.followed is None:
        return
    judged, _, pairs = side.followed
    truth, steps = judged.candidates.truth, side.tracks.steps
    for row in np.flatnonzero((pairs.event & SWITCH) != 0).tolist():
        step = int(truth.step[row])
        camera = steps.camera[step] if steps.camera else ""
        yield (int(steps.frame[step]), int(truth.track_id[row]), camera), row


def join_events(events: Iterable[Event], cell: str, records: Mapping[int, FrameRecord]) -> Iterator[ObjectChange]:
    """Join the events of one object in frames that follow each other."""
    order = {index: place for place, index in enumerate(sorted(records))}
    start_ns = min((record.stamp_ns for record in records.values()), default=0)
    groups: dict[tuple[str, int, str, str], list[Event]] = {}
    for event in sorted(events, key=lambda e: (e.kind, e.identity, e.label, e.camera, e.frame)):
        groups.setdefault((event.kind, event.identity, event.label, event.camera), []).append(event)
    for own in groups.values():
        places = np.array([order[event.frame] for event in own])
        borders = [0, *(np.flatnonzero(np.diff(places) > _GAP) + 1).tolist(), len(own)]
        yield from (_change(own[a:b], cell, records, start_ns) for a, b in pairwise(borders))


def _change(part: Sequence[Event], cell: str, records: Mapping[int, FrameRecord], start_ns: int) -> ObjectChange:
    event, first, last = part[0], part[0].frame, part[-1].frame
    from_s, to_s = ((records[frame].stamp_ns - start_ns) / 1e9 for frame in (first, last))
    ranges = [e.place[0] for e in part if np.isfinite(e.place[0])]
    far = float(np.mean(ranges)) if ranges else None
    # Of several reasons the most frequent one, as a reader wants one.
    reasons = [e.why for e in part]
    why = max(dict.fromkeys(reasons), key=reasons.count) + (f", in camera {event.camera}" if event.camera else "")
    number = None if event.identity < 0 or event.kind == "NEW FALSE ALARM" else event.identity
    num = len({e.frame for e in part})
    names = event.kind, cell, event.label, number
    return ObjectChange(*names, from_s, to_s, (first, last), num, far, why, event.place[1])


def _worst(pair: CellPair, records: Mapping[int, FrameRecord], most: int = 5) -> list[WorstFrame]:
    """The frames in which detections have most more errors than before."""
    places = [p for p in pair.base.frames.counts if p[:3] == ("detection", VEHICLE.name, "all")]
    one, two = pair.base.frames, pair.head.frames
    if not places or places[0] not in two.counts or not np.array_equal(one.stamp_ns, two.stamp_ns):
        return []
    errors = [side.counts[places[0]][:, 1:].sum(axis=1) for side in (one, two)]
    more = errors[1] - errors[0]
    rows = [row for row in np.argsort(-more, kind="stable")[:most].tolist() if more[row] > 0]
    index = {record.stamp_ns: record.index for record in records.values()}
    start_ns = min(record.stamp_ns for record in records.values())
    stamps = one.stamp_ns.tolist()
    return [
        WorstFrame(str(pair.name), index[stamps[row]], (stamps[row] - start_ns) / 1e9, *(int(e[row]) for e in errors))
        for row in rows
    ]


def find_divergence(pair: CellPair) -> Divergence | None:
    """Return the first frame, and in it the first stage, in which outputs differ, from digests and results alone;
    `None` where they are equal, or one side is a baseline.
    """
    if pair.base.run is None or pair.head.run is None:
        return None
    base, head = pair.base.run, pair.head.run
    others = {frame.stamp_ns: frame for frame in head.frames}
    both = [(a, others[a.stamp_ns]) for a in base.frames if a.stamp_ns in others]
    different = [(a, b) for a, b in both if a.digest != b.digest]
    if not different:
        return None
    stage, what = _first_stage(base, head, *different[0])
    start_ns = base.frames[0].stamp_ns
    place = different[0][0].index, (different[0][0].stamp_ns - start_ns) / 1e9
    return Divergence(str(pair.name), *place, stage, what, len(different))


def _first_stage(base: Run, head: Run, a: FrameRecord, b: FrameRecord) -> tuple[str, str]:
    if a.segment != b.segment:
        return "frames", "segment differs"
    if dict(a.missing) != dict(b.missing):
        names = sorted(n for n in {*a.missing, *b.missing} if a.missing.get(n) != b.missing.get(n))
        said = [f"{name} {a.missing.get(name, 'there')} -> {b.missing.get(name, 'there')}" for name in names]
        return "frames", "; ".join(said)
    if a.failed != b.failed:
        return "detections", f"failed: {a.failed} -> {b.failed}"
    for stage in a.stages:
        if stage in b.stages and a.stages[stage] != b.stages[stage]:
            return stage, "its result differs"
    for table, one, two in (("detections", base.detections, head.detections), ("tracks", base.tracks, head.tracks)):
        if (what := boxes_difference(one.at(a.index), two.at(b.index))) is not None:
            return ("track" if table == "tracks" else _name_detection(base, a)), what
    return "track", "digest differs"


def _name_detection(run: Run, frame: FrameRecord) -> str:
    """The stage that detections come from: fusion, or the only kind of sensor that detects."""
    kinds = [stage.removeprefix("detect.") for stage in run.frame_times if stage.startswith("detect.")]
    return "fuse" if frame.stages else kinds[0] if len(kinds) == 1 else "detections"
