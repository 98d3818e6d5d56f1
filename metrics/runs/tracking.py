"""Scores of a run's tracks."""

from collections.abc import Sequence
from dataclasses import replace

from fbench.metrics.core.slices import VEHICLE, ScoreCounts, by_seen
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.spaces import measure_classes, views
from fbench.metrics.tracking.scores import TrackingCounts, require_unique_ids, tracking_counts, tracking_rows
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

NO_TRACKS = "the pipeline gave no tracks"


class Tracking:
    """CLEAR MOT, identity and HOTA of `run.tracks`.

    - `mota` = 1 - sum(FN + FP + IDSW) / sum(GT), up to 1, not clipped below (Bernardin and Stiefelhagen 2008).
    - `mota_no_fp` = 1 - sum(FN + IDSW) / sum(GT): leaves out false alarms, and so is not MOTA; it rewards a tracker
      that floods the scene. Kept because the thesis that fbench follows prints it as MOTA.
    - `motp`: mean over all matches, of the distance [m] in the ground plane or of the IoU in images.
    - `idsw`: how often truth was matched to another track than at its last match, any gap of frames between them.
    - `frag`, `mt`, `pt`, `ml`: interruptions, and truth tracks by the share of their boxes that was found.
    - `idf1`, `idp`, `idr` (Ristani et al. 2016), `hota`, `deta`, `assa`, `loca` (Luiten et al. 2020).
    - `occlusion_survival`: share of occlusions after which an object has the id that it had before.

    A pair of the previous scored frame that had truth and tracks stays while it is inside the threshold; the rest is
    matched for most pairs, then best total. Identities don't continue over segment borders, nor from one camera to
    another. Without truth boxes, or where truth or tracks have no ids, what needs them is null; all is where the
    pipeline doesn't track.
    """

    def scores(self, run: Run, options: ScoreOptions) -> Sequence[Score]:
        """Return rows of all vehicles in each space, of labels, of what is seen. MetricError: id twice in a frame."""
        return [row for entry in tracking_entries(run, options) for row in rows_of(entry)]


def tracking_entries(
    run: Run, options: ScoreOptions, match: Match | None = None
) -> tuple[ScoreCounts[TrackingCounts], ...]:
    """Measure the tracks of a run: all vehicles in each space, then labels and what is seen in its own space, or in
    that of `match`, see `views`. Raises MetricError where an id occurs twice in one frame.
    """
    spaces = views(run, run.tracks, options, match)
    # The folder may still have a name that nobody knows.
    where = f"'{run.manifest.pipeline}' on log '{run.manifest.log.name}'"
    for view in spaces:
        require_unique_ids(view.sequence, where)
    entries, native = measure_tracks(run, spaces), spaces[0]
    # Only what holds for whole tracks is a slice: what is seen, but not distances, which change along a track.
    parts = () if native.key.reason or options.seen else by_seen(native.sequence)
    slices = [
        ScoreCounts(replace(native.key, slice=part.name), tracking_counts(native.sequence, VEHICLE, native.match, part))
        for part in parts
    ]
    return *entries, *_require_tracks(run, slices)


def measure_tracks(run: Run, spaces: Sequence[View]) -> tuple[ScoreCounts[TrackingCounts], ...]:
    """Measure all vehicles in each of these views of a run's tracks, then labels in the first."""
    return _require_tracks(run, measure_classes(spaces, run.tracks, tracking_counts, TrackingCounts()))


def _require_tracks(
    run: Run, entries: Sequence[ScoreCounts[TrackingCounts]]
) -> tuple[ScoreCounts[TrackingCounts], ...]:
    """Leave entries of a pipeline that doesn't track without values. Their counts stay, for sums over several runs."""
    if run.manifest.has_tracks:
        return tuple(entries)
    return tuple(replace(e, key=replace(e.key, reason=e.key.reason or NO_TRACKS)) for e in entries)


def rows_of(entry: ScoreCounts[TrackingCounts]) -> list[Score]:
    """Return the rows of one entry."""
    unit = "iou" if entry.key.matching.startswith("iou") else "m"
    return tracking_rows(entry.counts, entry.key, unit)
