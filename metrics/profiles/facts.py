"""What must be known of profiles to bring them together with results."""

from collections.abc import Mapping
from dataclasses import dataclass

from fbench.metrics.objects import Space
from fbench.metrics.profiles.catalog import AnyProfile
from fbench.metrics.reference_runs.names import Family


@dataclass(frozen=True)
class Facts:
    """What a profile judges."""

    judges_tracks: bool
    space: Space
    """Where its boxes must be; `both`: wherever the results have them."""
    family: Family | None = None
    """By whose names classes go; `None`: by those of fbench."""


_FACTS: Mapping[str, Facts] = {
    "default": Facts(True, "both"),
    "trackeval-kitti": Facts(True, "2d", "kitti-tracking"),
    "trackeval-mot": Facts(True, "2d", "mot"),
    "trackeval-mot15": Facts(True, "2d", "mot"),
    "trackeval-mot20": Facts(True, "2d", "mot"),
    "motmetrics": Facts(True, "2d", "mot"),
    "nuscenes-detection": Facts(False, "3d", "nuscenes"),
    "nuscenes-tracking": Facts(True, "3d", "nuscenes-tracking"),
    "kitti-object": Facts(False, "both", "kitti-tracking"),
    "kitti-3dmot": Facts(True, "3d", "kitti-tracking"),
    "coco": Facts(False, "2d"),
}


def facts_of(profile: AnyProfile) -> Facts:
    """Return what a profile of the catalogue judges."""
    return _FACTS[profile.name]
