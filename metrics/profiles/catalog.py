"""Every profile by its name, its facts and its description; none is imported before it is asked for."""

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from fbench.metrics.core.sequence import Space
from fbench.metrics.profiles.profile import Match, Profile
from fbench.metrics.reference_runs.rows import Family
from fbench.replay.contracts.errors import ConfigError, did_you_mean

AnyProfile = Profile[Any]


def profile_of(name: str) -> AnyProfile:
    """Return a profile. Raises ConfigError for an unknown name, with the nearest one."""
    if name not in PROFILES:
        raise ConfigError(f"unknown profile '{name}'{did_you_mean(name, PROFILES)}")
    return PROFILES[name]()


def _default() -> AnyProfile:
    from fbench.metrics.profiles.default import DefaultProfile

    return DefaultProfile()


def _trackeval_kitti() -> AnyProfile:
    from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI

    return TRACKEVAL_KITTI


def _trackeval_mot() -> AnyProfile:
    from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_MOT

    return TRACKEVAL_MOT


def _trackeval_mot15() -> AnyProfile:
    from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_MOT15

    return TRACKEVAL_MOT15


def _trackeval_mot20() -> AnyProfile:
    from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_MOT20

    return TRACKEVAL_MOT20


def _motmetrics() -> AnyProfile:
    from fbench.metrics.profiles.motmetrics import MOTMETRICS

    return MOTMETRICS


def _nuscenes_detection() -> AnyProfile:
    from fbench.metrics.profiles.nuscenes.detection import NuscenesDetection

    return NuscenesDetection()


def _nuscenes_tracking() -> AnyProfile:
    from fbench.metrics.profiles.nuscenes.tracking import NuscenesTracking

    return NuscenesTracking()


def _kitti_object() -> AnyProfile:
    from fbench.metrics.profiles.kitti.object import KittiObject

    return KittiObject()


def _kitti_3dmot() -> AnyProfile:
    from fbench.metrics.profiles.kitti.tracking import Kitti3dMot

    return Kitti3dMot()


def _coco() -> AnyProfile:
    from fbench.metrics.profiles.coco.profile import CocoProfile

    return CocoProfile()


PROFILES: Mapping[str, Callable[[], AnyProfile]] = {
    "default": _default,
    "trackeval-kitti": _trackeval_kitti,
    "trackeval-mot": _trackeval_mot,
    "trackeval-mot15": _trackeval_mot15,
    "trackeval-mot20": _trackeval_mot20,
    "motmetrics": _motmetrics,
    "nuscenes-detection": _nuscenes_detection,
    "nuscenes-tracking": _nuscenes_tracking,
    "kitti-object": _kitti_object,
    "kitti-3dmot": _kitti_3dmot,
    "coco": _coco,
}
NEEDS_WORLD = ("nuscenes-detection", "nuscenes-tracking")
"""Their ranges are about the ego, so that one must know where it is where boxes are in the world."""
NEEDS_TIME = ("nuscenes-tracking",)


@dataclass(frozen=True)
class Facts:
    """What a profile judges."""

    judges_tracks: bool
    space: Space  # Where its boxes must be; `both`: wherever the results have them
    family: Family | None = None  # By whose names classes go; `None`: by those of fbench


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


_APART = ("name", "summary")


def described(profile: AnyProfile) -> dict[str, str]:
    """Return all that a profile fixes, by dotted names."""
    return {path: text for path, text in _items("", profile) if path not in _APART}


def explained(profile: AnyProfile) -> str:
    """Return what its class says of how it counts."""
    return inspect.getdoc(type(profile)) or ""


def _items(path: str, value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, Match):
        yield path, str(value)
    elif is_dataclass(value):
        for own in fields(value):
            yield from _items(f"{path}.{own.name}" if path else own.name, getattr(value, own.name))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _items(f"{path}.{key}", item)
    elif isinstance(value, tuple) and any(is_dataclass(item) and not isinstance(item, Match) for item in value):
        for i, item in enumerate(value):
            yield from _items(f"{path}[{i}]", item)
    else:
        yield path, _text(value)


def _text(value: object) -> str:
    if isinstance(value, str | Match):
        return str(value) or "–"
    if isinstance(value, Collection):
        texts = [_text(item) for item in value]
        return ", ".join(sorted(texts) if isinstance(value, set | frozenset) else texts) or "–"
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
