"""A run folder as the sequence that a profile scores."""

import math
from dataclasses import replace

import numpy as np

from fbench.metrics.profile import Match
from fbench.metrics.profiles.catalog import NEEDS_TIME, NEEDS_WORLD, AnyProfile
from fbench.metrics.profiles.default import IN_IMAGES, IN_SPACE, DefaultProfile
from fbench.metrics.profiles.facts import Facts, facts_of
from fbench.metrics.reference_runs.images import image_sequence
from fbench.metrics.reference_runs.view import Space
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


def fitted_to(run: Run, profile: AnyProfile, match: Match | None) -> AnyProfile:
    """Return the profile as it fits a run: `default` matches in space where the results are there, else in images.

    Args:
        run: Whose tracks are scored.
        profile: As it was chosen.
        match: What the user said of how boxes match.
    """
    if isinstance(profile, DefaultProfile) and match is None:
        return replace(profile, match=IN_IMAGES if isinstance(run.tracks.boxes, Boxes2D) else IN_SPACE)
    return profile


def run_sequence(run: Run, profile: AnyProfile, match: Match | None = None) -> Sequence:
    """Return truth and results of a run as the benchmark's own files would have them: tracks or detections, in images,
    the body or the world, with the benchmark's names of classes.

    All boxes are there, wherever they are: a benchmark has regions of its own.

    Args:
        run: With truth.
        profile: As `fitted_to` gives it.
        match: What the user said of how boxes match: a profile in images matches in space by it, and the other way
            round.

    Raises:
        MetricError: where nothing has truth of the kind (GT001), or results aren't of it.
    """
    facts = facts_of(profile)
    table = run.tracks if facts.judges_tracks else run.detections
    space = _space(facts, profile, match)
    if space == "3d" and isinstance(table.boxes, Boxes2D):
        raise MetricError(f"{run.folder}: {profile.name} needs 3D boxes, and the results are in images")
    if facts.family is None:
        return _own_sequence(run, table, space)
    if profile.name in NEEDS_WORLD:
        return world_sequence(run, table, facts.family, needs_world=profile.name in NEEDS_TIME)
    sequence = image_sequence(run, table, facts.family, space)
    return _of_its_classes(sequence, profile) if isinstance(profile, TrackEvalProfile) else sequence


def misses_classes(sequence: Sequence, profile: AnyProfile) -> bool:
    """Tell whether no result says what it is, though the profile counts classes one by one."""
    labels = sequence.estimates.label
    takes_any = profile.name == "default" or facts_of(profile).family == "mot"
    return not takes_any and len(labels) > 0 and not (labels != "").any()


def _space(facts: Facts, profile: AnyProfile, match: Match | None) -> Space:
    told = profile.match if isinstance(profile, DefaultProfile) else match
    if told is None or (facts.space == "both" and facts.family is not None):
        return facts.space
    return "2d" if told.likeness == "iou2d" else "3d"


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
