"""Outcomes of all boxes of a run, by their rows in its tables: `hit`, `missed`, `false alarm`, `ignored`, `invalid`."""

from collections import Counter
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from fbench.metrics.core.slices import VEHICLE, Group, find_labels, label_group
from fbench.metrics.detection.outcomes import Judgement, Outcome, compare_class, judge_detections
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.tracking.scores import follow_tracks, require_unique_ids
from fbench.replay.data.boxes import LABELS, VEHICLES, Boxes, Boxes3D
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.data.sequences import Objects
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable

Place: TypeAlias = tuple[int, str]
"""Row of a table, and the camera in whose image the box was compared; empty in 3D."""
_NAMES = {
    Outcome.HIT: "hit", Outcome.FALSE_ALARM: "false alarm", Outcome.INVALID: "invalid", Outcome.OUTSIDE: "ignored",
    Outcome.EXCUSED: "ignored",
}  # fmt: skip


def outcomes_of(run: Run, options: ScoreOptions) -> dict[str, dict[Place, str]]:
    """Return what became of the boxes of `truth` (or `truth_2d`), `detections` and `tracks` in the run's own space, as
    the scores count them; truth is compared with detections. All vehicles are one class; other labels are compared one
    by one where the pipeline knows them. Boxes of frames without truth are left out. Raises MetricError where an id
    occurs twice in a frame (GT003).
    """
    shared = run if isinstance(run, SharedRun) else SharedRun(run.folder)
    detected, tracked = (views(shared, table, options)[0] for table in (shared.detections, shared.tracks))
    found: dict[str, dict[Place, str]] = {name: {} for name in ("truth", "truth_2d", "detections", "tracks")}
    if detected.key.reason:
        return found
    require_unique_ids(tracked.sequence, str(run.folder))
    for name, view, judge in (("detections", detected, _judge_detections), ("tracks", tracked, _judge_tracks)):
        table = shared.detections if name == "detections" else shared.tracks
        places = list(_places(view.sequence.estimates, view, table))
        found[name] = dict.fromkeys(places, "ignored")
        judgements = [judge(view, group) for group in _groups(view, table)]
        for judgement in judgements:
            for row, outcome in zip(judgement.candidates.estimate_row, judgement.outcome, strict=True):
                _set(found[name], places[row], _NAMES[Outcome(outcome)])
        if name == "detections":
            truth, is_2d = view.sequence.truth, view.sequence.truth.center_m is None
            of_truth = list(_places(truth, view, shared.truth_table("2d" if is_2d else "3d")))
            own = found["truth_2d" if is_2d else "truth"] = dict.fromkeys(of_truth, "ignored")
            for judgement in judgements:
                hit = set(judgement.truth_of_estimate.tolist())
                for number, row in enumerate(judgement.candidates.truth_row):
                    _set(own, of_truth[row], "hit" if number in hit else "missed")
    return found


def _set(outcomes: dict[Place, str], place: Place, outcome: str) -> None:
    """Keep what one class said unless it only ignores the box."""
    if outcomes[place] == "ignored":
        outcomes[place] = outcome


def _groups(view: View, table: BoxTable) -> list[Group]:
    """Classes that are told apart: vehicles, and the other labels where the pipeline knows labels."""
    if table.boxes.label is None:
        return [VEHICLE]
    met = find_labels(view.sequence.truth, view.sequence.estimates)
    return [VEHICLE, *(label_group(label) for label in LABELS if label in met and label not in VEHICLES)]


def _judge_detections(view: View, group: Group) -> Judgement:
    return judge_detections(compare_class(view.sequence, group, view.match))


def _judge_tracks(view: View, group: Group) -> Judgement:
    return follow_tracks(view.sequence, group, view.match)[0]


def _places(objects: Objects, view: View, table: BoxTable) -> Iterator[Place]:
    """Yield the place of each object. Metrics sort boxes by content, so equal content is what leads back to the row;
    a box in space comes once for each image that shows it.
    """
    steps, is_3d = view.sequence.steps, isinstance(table.boxes, Boxes3D)
    rows: dict[tuple[object, ...], list[int]] = {}
    cameras = [""] * len(table.frames) if isinstance(table.boxes, Boxes3D) else table.boxes.camera.tolist()
    for row, key in enumerate(zip(table.frames.tolist(), cameras, *_content(table.boxes, is_3d), strict=True)):
        rows.setdefault(key, []).append(row)
    taken = Counter[tuple[object, ...]]()
    frames, content = steps.frame[objects.step].tolist(), zip(*_content(objects, is_3d), strict=True)
    for step, frame, (values, label) in zip(objects.step.tolist(), frames, content, strict=True):
        camera = steps.camera[step] if steps.camera else ""
        key = (frame, "" if is_3d else camera, values, label)
        yield rows[key][taken[(camera, *key)]], camera
        taken[(camera, *key)] += 1


def _content(boxes: Objects | Boxes, is_3d: bool) -> tuple[list[bytes], list[str]]:
    """Return what tells boxes apart: bits of geometry, score and id, and the label."""
    num, label = len(boxes), boxes.label
    geometry = [getattr(boxes, name) for name in (("center_m", "size_lwh_m") if is_3d else ("xyxy_px",))]
    score = np.zeros(num) if boxes.score is None else boxes.score
    track_id = np.full(num, -1) if boxes.track_id is None else boxes.track_id
    table = np.column_stack([*geometry, score, track_id]).astype(np.float64)
    return [row.tobytes() for row in table], [""] * num if label is None else label.tolist()
