"""Every profile by its name; none is imported before it is asked for, because some compile kernels."""

from collections.abc import Callable, Mapping
from typing import Any

from fbench.metrics.profile import Profile
from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean

AnyProfile = Profile[Any]


def profile_of(name: str) -> AnyProfile:
    """Return a profile.

    Raises:
        ConfigError: for an unknown name, with the nearest one.
    """
    if name not in PROFILES:
        raise ConfigError(f"unknown profile '{name}'{did_you_mean(name, PROFILES)}")
    return PROFILES[name]()


def _default() -> AnyProfile:
    from fbench.metrics.profiles.default import DefaultProfile

    return DefaultProfile()


def _trackeval_kitti() -> AnyProfile:
    from fbench.metrics.tracking.trackeval import TRACKEVAL_KITTI

    return TRACKEVAL_KITTI


def _trackeval_mot() -> AnyProfile:
    from fbench.metrics.tracking.trackeval import TRACKEVAL_MOT

    return TRACKEVAL_MOT


def _trackeval_mot15() -> AnyProfile:
    from fbench.metrics.tracking.trackeval import TRACKEVAL_MOT15

    return TRACKEVAL_MOT15


def _trackeval_mot20() -> AnyProfile:
    from fbench.metrics.tracking.trackeval import TRACKEVAL_MOT20

    return TRACKEVAL_MOT20


def _motmetrics() -> AnyProfile:
    from fbench.metrics.tracking.motmetrics import MOTMETRICS

    return MOTMETRICS


def _nuscenes_detection() -> AnyProfile:
    from fbench.metrics.nuscenes.detection import NuscenesDetection

    return NuscenesDetection()


def _nuscenes_tracking() -> AnyProfile:
    from fbench.metrics.nuscenes.tracking import NuscenesTracking

    return NuscenesTracking()


def _kitti_object() -> AnyProfile:
    from fbench.metrics.kitti.objects3d import KittiObject

    return KittiObject()


def _kitti_3dmot() -> AnyProfile:
    from fbench.metrics.kitti.mot3d import Kitti3dMot

    return Kitti3dMot()


def _coco() -> AnyProfile:
    from fbench.metrics.coco.profile import CocoProfile

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
