"""Metadata of a log that fbench acts on: its keys, the outline of the vehicle, and regions with road users."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

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
EGO = "ego"  # `ego.front_m` and so on: see `Outline`
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


@dataclass(frozen=True)
class Outline:
    """How far the vehicle with the sensors reaches from the body's origin [m]."""

    front_m: float
    rear_m: float
    side_m: float


_SIMULATED = Outline(2.25, 2.25, 0.9)  # The city's ego: the origin is in the middle of 4.3 to 4.7 m
_KITTI = Outline(2.6, 2.1, 0.9)  # A VW Passat around camera 0, by KITTI's drawing of its sensors
_REAR_AXLE = Outline(3.7, 1.0, 0.9)  # Elsewhere: a car around its rear axle, as nuScenes, Waymo and Argoverse 2 have it


def outline_of(metadata: Mapping[str, str]) -> Outline:
    """Return a vehicle's outline by its log: `ego.front_m`, `ego.rear_m`, `ego.side_m`; what they don't say is that of
    a usual car. Raises LogError where one of them isn't a number above 0.
    """
    usual = _SIMULATED if SIMULATED in metadata else _KITTI if CAMERA0 in metadata else _REAR_AXLE
    found = {}
    for field in fields(Outline):
        text = metadata.get(f"{EGO}.{field.name}")
        try:
            found[field.name] = getattr(usual, field.name) if text is None else float(text)
        except ValueError:
            found[field.name] = 0.0
        if not 0 < found[field.name] < 100:
            raise LogError(f"the log's metadata '{EGO}.{field.name}' is '{text}': expected a length in meters above 0")
    return Outline(**found)


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
