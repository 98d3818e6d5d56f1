"""Metadata of a log that fbench acts on: its keys, and regions where road users are expected."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import DataError, LogError
from fbench.replay.data.arrays import Array, Float64, freeze_fields

REFERENCE = "reference"  # Sensor whose stamps are the instants of frames
TIMEOUT_MS = "timeout_ms"  # How long frames wait for their sensors
CAMERA0 = "kitti.camera0"  # `body`: the body's coordinates are those of KITTI's camera 0, its axes turned
GAPS, MEANT = "gaps", "meant"  # With this value frames are no sequence, so that gaps between them are no problem
SIMULATED = "simulated"  # Version of the simulation that made the log; real logs lack it
SCENE_ID = "scene_id"
"""Equal texts: the same drive with the same truth, under whatever weather and with whatever sensors."""
REGIONS = "regions"  # Outlines of roads and sidewalks, see `regions_text`
MAX_POINTS = 200_000  # Of all outlines of a log


@dataclass(frozen=True, eq=False)
class Region:
    """One outline in the ground plane, without holes; regions may overlap."""

    kind: str  # What it is, such as `road` or `sidewalk`
    points_m: Float64  # (P, 2) x, y in world coordinates, counter-clockwise, not closed; at least 3

    def __post_init__(self) -> None:
        freeze_fields(self, points_m=("f8", ("P", 2)))
        if len(self.points_m) < 3 or not np.isfinite(self.points_m).all():
            raise DataError(f"Region.points_m: expected 3 or more finite points, got {self.points_m.tolist()[:3]}")


def regions_text(regions: Sequence[Region]) -> str:
    """Return regions as the text that a log's metadata hold, JSON with every digit."""
    rows = [{"kind": region.kind, "points": region.points_m.tolist()} for region in regions]
    return json.dumps(rows, separators=(",", ":"))


def regions_of(metadata: Mapping[str, str]) -> tuple[Region, ...]:
    """Return a log's regions, if it has any. Raises LogError where the text isn't what `regions_text` makes."""
    try:
        regions: list[Region] = []
        for row in json.loads(metadata.get(REGIONS, "[]")):
            if not isinstance(row["kind"], str):
                raise TypeError
            regions.append(Region(row["kind"], np.array(row["points"], np.float64)))
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError, DataError) as error:
        raise LogError(f"the log's metadata '{REGIONS}' aren't outlines ({type(error).__name__})") from error
    if sum(len(region.points_m) for region in regions) > MAX_POINTS:
        raise LogError(f"the log's metadata '{REGIONS}' have more than {MAX_POINTS} points")
    return tuple(regions)


def inside(regions: Sequence[Region], xy_m: Array) -> Array:
    """Tell which points (N, 2) [m] lie in any region, by the even-odd rule; a point on a border may count as either."""
    points = np.asarray(xy_m, np.float64)
    found = np.zeros(len(points), bool)
    for region in regions:
        low, high = region.points_m.min(axis=0), region.points_m.max(axis=0)
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1) & ~found)
        (x, y), odd = points[near].T, np.zeros(len(near), bool)
        corners = region.points_m if len(near) else region.points_m[:0]
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if y0 != y1:
                odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * ((x1 - x0) / (y1 - y0)))
        found[near] = odd
    return found
