"""A run folder as the sequence that a profile scores."""

import math
from dataclasses import replace

import numpy as np

from fbench.metrics.objects import Space
from fbench.metrics.profile import Match
from fbench.metrics.profiles.catalog import NEEDS_TIME, NEEDS_WORLD, AnyProfile
from fbench.metrics.profiles.facts import Facts, facts_of
from fbench.metrics.reference_runs.images import image_sequence
from fbench.metrics.reference_runs.world import world_sequence
from fbench.metrics.runs.ground import ground_view
from fbench.metrics.runs.image import image_view
from fbench.metrics.sequence import Sequence
from fbench.metrics.tracking.trackeval import TrackEvalProfile
from fbench.replay.boxes import Boxes2D
from fbench.replay.errors import MetricError
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.tables import BoxTable


def run_sequence(run: Run, profile: AnyProfile, match: Match | None = None) -> Sequence:
    """Return truth and results of a run as the benchmark's own files would have them: tracks or detections, in images,
    the body or the world, with the benchmark's names of classes.

    All boxes are there, wherever they are: a benchmark has regions of its own.

    Args:
        run: With truth.
        profile: A benchmark's; what `default` says of runs is in `own_rows`.
        match: What the user said of how boxes match: a profile in images matches in space by it, and the other way
            round.

    Raises:
        MetricError: where nothing has truth of the kind (GT001), or results aren't of it.
    """
    facts = facts_of(profile)
    table = run.tracks if facts.judges_tracks else run.detections
    space = _space(facts, match)
    if space == "3d" and isinstance(table.boxes, Boxes2D):
        raise MetricError(f"{run.folder}: {profile.name} needs 3D boxes, and the results are in images")
    if facts.family is None:
        return _own_sequence(run, table, space)
    if profile.name in NEEDS_WORLD:
        return world_sequence(run, table, facts.family, needs_world=profile.name in NEEDS_TIME)
    sequence = image_sequence(run, table, facts.family, space)
    return _of_its_classes(sequence, profile) if isinstance(profile, TrackEvalProfile) else sequence


def _space(facts: Facts, match: Match | None) -> Space:
    if match is None or (facts.space == "both" and facts.family is not None):
        return facts.space
    return "2d" if match.likeness == "iou2d" else "3d"


def _own_sequence(run: Run, table: BoxTable, space: Space) -> Sequence:
    """By fbench's names, everywhere."""
    everywhere = ScoreOptions(range_m=math.inf, in_view=False)
    view = image_view(run, table, everywhere) if space == "2d" else ground_view(run, table, everywhere)
    if view.reason is not None:
        raise MetricError(
            f"{run.folder}: {view.reason}, so there is nothing to score", "GT001" if view.reason == "no truth" else ""
        )
    return view.sequence


def _of_its_classes(sequence: Sequence, profile: TrackEvalProfile) -> Sequence:
    """Leave out results of classes that TrackEval would refuse: a detector of cars may find pedestrians too."""
    allowed = sorted(profile.preparation.only_labels)
    if not allowed:
        return sequence
    kept = np.isin(sequence.estimates.label, allowed)
    return sequence if kept.all() else replace(sequence, estimates=sequence.estimates[kept])
