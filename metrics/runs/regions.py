"""Regions of a log, such as roads and sidewalks, as slices."""

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.runs.places import ground_points, has_poses, regions_of
from fbench.metrics.sequence import Sequence
from fbench.metrics.standard.slices import Part
from fbench.replay.arrays import Float64
from fbench.replay.regions import inside
from fbench.replay.store import Run


def region_parts(run: Run, sequence: Sequence) -> list[Part]:
    """Return the part of a sequence in the ground plane that lies in each kind of the log's regions; none where the
    log has no regions or no poses.
    """
    if sequence.truth.center_m is None or sequence.estimates.center_m is None:
        return []
    regions = regions_of(run)
    kinds = dict.fromkeys(region.kind for region in regions)
    if not kinds or not has_poses(run):
        return []
    sides = [_points(run, sequence, objects) for objects in (sequence.truth, sequence.estimates)]
    return [
        Part(f"region {kind}", *(inside([r for r in regions if r.kind == kind], points) for points in sides))
        for kind in kinds
    ]


def _points(run: Run, sequence: Sequence, objects: Objects) -> Float64:
    center_m = np.zeros((0, 3)) if objects.center_m is None else objects.center_m
    return ground_points(run, sequence.steps.frame[objects.step], center_m)
