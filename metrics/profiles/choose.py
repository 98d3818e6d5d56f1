"""Choice of a profile and a match for given results, and scoring of sequences by it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from fbench.metrics.files.sequences import FilePair
from fbench.metrics.files.side import InputWarning, has_solids
from fbench.metrics.profiles.catalog import AnyProfile, profile_of
from fbench.metrics.profiles.default import IN_IMAGES, IN_SPACE, DefaultProfile
from fbench.metrics.profiles.kitti.tracking import Kitti3dMot
from fbench.metrics.profiles.trackeval.profiles import TracksProfile
from fbench.replay.contracts.errors import ConfigError, MetricError, did_you_mean
from fbench.replay.contracts.profiles import Match, Profile, Statistics
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.data.sequences import Sequence, Space

if TYPE_CHECKING:  # reading of runs and resampling take a while to import
    from fbench.metrics.core.bootstrap import Bootstrap
    from fbench.replay.runs.folder import Run


def choose_profile(name: str, match: str | None) -> AnyProfile:
    """Return a profile by its name, with a match as after `--match`; `None`: as the profile has it.

    Raises ConfigError for an unknown name, or a match that the profile can't do.
    """
    profile = profile_of(name)
    return profile if match is None else profile.with_match(Match.parse(match))


def fit_profile(profile: AnyProfile, pair: FilePair, has_match: bool) -> AnyProfile:
    """Return the profile as it fits files, whose first sequences are looked into: `default` matches in space where both
    sides have 3D boxes, else in images, unless the user said what matches (`has_match`).

    Raises ConfigError where the files don't say what the profile needs: the order of samples, or where the body is.
    """
    if isinstance(profile, DefaultProfile) and not has_match:
        for one in pair.pairs:
            truth = pair.truth.read(one.truth).objects
            estimates = None if one.estimates is None else pair.estimates.read(one.estimates).objects
            if estimates is not None and len(truth) and len(estimates):
                in_space = has_solids(truth) and has_solids(estimates)
                return replace(profile, match=IN_SPACE if in_space else IN_IMAGES)
        return replace(profile, match=IN_IMAGES)
    if profile.facts.needs_ego or profile.facts.needs_time:
        results = pair.estimates.submission() if profile.name == "nuscenes-detection" else None
        if results is not None and results.task == "tracking":
            pair.warnings.add(InputWarning("submission of tracking, whose boxes are taken as detections", 1))
        side = pair.truth.read(pair.pairs[0].truth)
        beside = f"put samples.csv (token, stamp_ns, scene, ego_x, ego_y, ego_z) beside {pair.truth.path}"
        if profile.facts.needs_time and not side.are_ordered:
            what = "nobody tells when the samples are"
            raise ConfigError(f"{profile.name}: {what}; {beside}, or sample.json of nuScenes")
        if side.space == "world" and side.ego_m is None:
            what = "boxes are in the world, and nobody tells where the ego is"
            raise ConfigError(f"{profile.name}: {what}; give truth ego_translation, or {beside}")
    return profile


def only(rows: Iterable[Score], classes: tuple[str, ...]) -> list[Score]:
    """Return the rows of some classes; all of them where none is named.

    Raises ConfigError where no row is of a class.
    """
    found = list(rows)
    known = list(dict.fromkeys(row.class_ for row in found))
    for name in classes:
        if name not in known:
            raise ConfigError(f"--class {name}: the profile has no rows of it{did_you_mean(name, known)}")
    return [row for row in found if not classes or row.class_ in classes]


def space_to_compare(profile: AnyProfile) -> Space:
    """Return where a profile compares boxes: what is wrong with them elsewhere is no matter to it."""
    if isinstance(profile, Kitti3dMot):
        return _space_of(profile.rules.match)
    return _space_of(profile.match) if isinstance(profile, DefaultProfile | TracksProfile) else profile.facts.space


def _space_of(match: Match) -> Space:
    return "2d" if match.kind == "iou2d" else "3d"


def run_sequence(run: "Run", profile: AnyProfile, match: Match | None = None) -> Sequence:
    """Return truth and results of a run as the benchmark's own files would have them: tracks or detections, in images,
    the body or the world, with the benchmark's names of classes.

    All boxes are there, wherever they are: a benchmark has regions of its own. What `default` says of runs is in
    `own_rows`. By a `match` of the user a profile in images matches in space, and the other way round. Raises
    MetricError where nothing has truth of the kind (GT001), or results aren't of it.
    """
    from fbench.metrics.reference_runs.images import image_sequence
    from fbench.metrics.reference_runs.world import body_sequence, world_sequence
    from fbench.metrics.runs.spaces import ground_view, image_view

    facts = profile.facts
    table = run.tracks if facts.judges_tracks else run.detections
    space = facts.space
    if match is not None and (space != "both" or facts.family is None):
        space = _space_of(match)
    if space == "3d" and isinstance(table.boxes, Boxes2D):
        raise MetricError(f"{run.folder}: {profile.name} needs 3D boxes, and the results are in images")
    if facts.family is None:  # by fbench's names, everywhere
        everywhere = ScoreOptions(range_m=math.inf, in_view=False)
        view = image_view(run, table, everywhere) if space == "2d" else ground_view(run, table, everywhere)
        if (reason := view.key.reason) is not None:
            code = "GT001" if reason == "no truth" else ""
            raise MetricError(f"{run.folder}: {reason}, so there is nothing to score", code)
        return view.sequence
    if facts.family == "av2":
        return body_sequence(run, table, facts.family)
    if facts.needs_ego:
        return world_sequence(run, table, facts.family, needs_world=facts.needs_time)
    sequence = image_sequence(run, table, facts.family, space)
    allowed = sorted(profile.preparation.only_labels) if isinstance(profile, TracksProfile) else []
    # Results of classes that TrackEval would refuse are left out: a detector of cars may find pedestrians too.
    kept = np.isin(sequence.estimates.label, allowed) | (not allowed)
    return sequence if kept.all() else replace(sequence, estimates=sequence.estimates[kept])


S = TypeVar("S", bound=Statistics)


@dataclass(frozen=True)
class Evaluation(Generic[S]):
    """Statistics of each sequence, in the order in which they came."""

    profile: Profile[S]
    statistics: dict[str, S]  # By the sequence's name

    @property
    def total(self) -> S:
        """The sum over all sequences."""
        return reduce(add, self.statistics.values())

    def scores(self, how: "Bootstrap | None" = None) -> list[Score]:
        """Return rows over all sequences, then of each where there are several.

        With resamples, `how`, the numbers over all have confidence intervals: what other sequences of their kind would
        give; none by default.
        """

        def rows_of(total: S) -> list[Score]:
            return self.profile.scores(total, "all")

        if how is None:
            rows = rows_of(self.total)
        else:
            from fbench.metrics.core.bootstrap import with_intervals

            rows = with_intervals(self.statistics, rows_of, how, "sequences")
        if len(self.statistics) > 1:
            for name, own in self.statistics.items():
                rows += self.profile.scores(own, f"sequence {name}")
        return rows


def evaluate(profile: Profile[S], sequences: Iterable[Sequence]) -> Evaluation[S]:
    """Measure sequences, holding one at a time. MetricError: none, two of one name, or one that can't be scored."""
    statistics: dict[str, S] = {}
    for sequence in sequences:
        if sequence.name in statistics:
            raise MetricError(f"two sequences are called '{sequence.name}'")
        statistics[sequence.name] = profile.measure(sequence)
    if not statistics:
        raise MetricError("no sequence to score")
    return Evaluation(profile, statistics)
