"""What the diploma thesis that fbench follows prints of its own system (tables 9.4 and 9.5), to stand beside ours."""

from collections.abc import Mapping
from dataclasses import dataclass

from fbench.metrics.robustness import Space


@dataclass(frozen=True)
class Published:
    """One configuration; all are ratios."""

    f1: float
    mota_no_fp: float
    """The thesis calls it MOTA; it leaves out false positives."""
    change: Mapping[str, float]
    """Relative change of F1 against the normal condition, by condition."""


def _published(f1: float, mota: float, traffic: float, rain: float, fog: float, night: float) -> Published:
    changes = {"traffic": traffic, "rain": rain, "fog": fog, "dense-fog": fog, "night": night}
    return Published(f1 / 100, mota / 100, {name: value / 100 for name, value in changes.items()})


_CAMERA = _published(68.24, 61.43, -12.37, -24.82, -37.64, -41.29)
_LIDAR = _published(71.51, 67.86, -9.41, -18.56, -22.34, -27.18)
_RADAR = _published(67.66, 49.14, -6.27, -8.43, -10.18, -14.92)
_CONFIGURATIONS: Mapping[tuple[str, Space], Published] = {
    ("camera2d", "image"): _CAMERA,
    ("lidar2d", "image"): _LIDAR,
    ("lidar3d", "3D"): _LIDAR,
    ("radar2d", "image"): _RADAR,
    ("radar3d", "3D"): _RADAR,
    ("early2d", "image"): _published(82.32, 74.65, -7.52, -13.78, -17.46, -20.31),
    ("early3d", "3D"): _published(80.71, 78.27, -6.48, -12.29, -15.63, -18.44),
    ("late2d", "image"): _published(85.16, 79.42, -5.36, -10.72, -12.58, -15.27),
    ("late3d", "3D"): _published(83.58, 82.66, -4.29, -8.65, -10.41, -12.16),
}
PUBLISHED: Mapping[tuple[str, Space], Published] = {
    **_CONFIGURATIONS, **{(f"thesis/{name}", space): own for (name, space), own in _CONFIGURATIONS.items()},
}  # fmt: skip
"""By pipeline and space: ours, then the thesis's as written. The thesis has one figure for each configuration and
doesn't say in which space: it stands beside the space of the configuration's own boxes, and beside no other.
"""
_ONE_FIGURE = (
    "The thesis has one figure for each configuration and doesn't say in which space: it stands beside the space of "
    "the configuration's own boxes alone, the image for those in 2D, 3D for those in 3D."
)
_BOTH = (
    "Its LiDAR only and radar only stand beside the 2D and the 3D configuration both; of its early 3D it doesn't say "
    "whether stereo is in it, so early3d-stereo has none."
)
_FOG = "How dense its fog is the thesis doesn't say: its figure stands beside fog and dense fog both."
NOTES = (_ONE_FIGURE, _BOTH, _FOG)
"""What who reads both must know."""
_NAMES = (
    "camera2d", "lidar2d", "lidar3d", "radar2d", "radar3d", "early2d", "early3d", "early3d-stereo", "late2d", "late3d",
)  # fmt: skip
ORDER = (*_NAMES, *(f"thesis/{name}" for name in _NAMES))
"""Of configurations, as the thesis has them; those without figures have their place, too."""
