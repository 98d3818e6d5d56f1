"""What the diploma thesis that fbench follows prints of its own system (tables 9.4 and 9.5), to stand beside ours."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """One configuration; all are ratios."""

    f1: float
    mota_no_fp: float
    """The thesis calls it MOTA; it leaves out false positives."""
    change: Mapping[str, float]
    """Relative change of F1 against the normal condition, by condition."""


def _published(f1: float, mota: float, traffic: float, rain: float, fog: float, night: float) -> Published:
    changes = {"traffic": traffic, "rain": rain, "fog": fog, "night": night}
    return Published(f1 / 100, mota / 100, {name: value / 100 for name, value in changes.items()})


_CAMERA = _published(68.24, 61.43, -12.37, -24.82, -37.64, -41.29)
_LIDAR = _published(71.51, 67.86, -9.41, -18.56, -22.34, -27.18)
_RADAR = _published(67.66, 49.14, -6.27, -8.43, -10.18, -14.92)
_CONFIGURATIONS = {
    "camera2d": _CAMERA,
    "lidar2d": _LIDAR,
    "lidar3d": _LIDAR,
    "radar2d": _RADAR,
    "radar3d": _RADAR,
    "early2d": _published(82.32, 74.65, -7.52, -13.78, -17.46, -20.31),
    "early3d": _published(80.71, 78.27, -6.48, -12.29, -15.63, -18.44),
    "late2d": _published(85.16, 79.42, -5.36, -10.72, -12.58, -15.27),
    "late3d": _published(83.58, 82.66, -4.29, -8.65, -10.41, -12.16),
}
PUBLISHED: Mapping[str, Published] = {
    **_CONFIGURATIONS, **{f"thesis/{name}": figures for name, figures in _CONFIGURATIONS.items()},
}  # fmt: skip
"""By pipeline, in the thesis's order: ours, then the thesis's as written. It has one figure for each sensor alone, and
doesn't say in which space.
"""
