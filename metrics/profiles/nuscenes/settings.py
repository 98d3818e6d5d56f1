"""Everything that the nuScenes benchmarks fix, as data."""

from dataclasses import dataclass

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Match


@dataclass(frozen=True)
class BoxRules:
    """Filters of both benchmarks; nuscenes-devkit 1.2.0, eval/common/loaders.py, `filter_eval_boxes`."""

    class_range_m: tuple[tuple[str, float], ...]
    """Classes with the distance from the ego, in the ground plane, from which on their boxes don't count."""
    max_boxes: int = 500  # Results with more boxes than this in one sample are refused
    rack_label: str = "static_object.bicycle_rack"
    rack_classes: tuple[str, ...] = ("bicycle", "motorcycle")
    """Their boxes don't count where the center is in a bicycle rack of the truth."""

    @property
    def classes(self) -> tuple[str, ...]:
        """Names, in the order of the benchmark's configuration."""
        return tuple(name for name, _ in self.class_range_m)


_RANGE_M = {
    **dict.fromkeys(("car", "truck", "bus", "trailer", "construction_vehicle"), 50.0),
    **dict.fromkeys(("pedestrian", "motorcycle", "bicycle"), 40.0),
    **dict.fromkeys(("traffic_cone", "barrier"), 30.0),
}
DETECTION_RULES = BoxRules(tuple(_RANGE_M.items()))
"""`detection_cvpr_2019.json`"""
_TRACKED = ("bicycle", "bus", "car", "motorcycle", "pedestrian", "trailer", "truck")
TRACKING_RULES = BoxRules(tuple((name, _RANGE_M[name]) for name in _TRACKED))
"""`tracking_nips_2019.json`"""


@dataclass(frozen=True)
class DetectionSettings:
    """`detection_cvpr_2019.json`"""

    rules: BoxRules = DETECTION_RULES
    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """Boxes match below each of these distances between centers in the ground plane."""
    error_distance_m: float = 2.0
    """One of `distances_m`: boxes that match at it have the errors that count."""
    min_recall: float = 0.1
    min_precision: float = 0.1
    map_weight: int = 5
    """What mAP counts in NDS, where each error counts 1."""

    @property
    def error_index(self) -> int:
        """Which of `distances_m` is `error_distance_m`."""
        return self.distances_m.index(self.error_distance_m)

    @property
    def matching(self) -> str:
        """What AP over all distances says of how boxes match."""
        return f"bev {', '.join(f'{m:g}' for m in self.distances_m)} m"

    @property
    def error_matching(self) -> str:
        """What errors say of it."""
        return str(Match("bev", self.error_distance_m))


@dataclass(frozen=True)
class TrackingSettings:
    """`tracking_nips_2019.json`"""

    rules: BoxRules = TRACKING_RULES
    distance_m: float = 2.0
    """Boxes match below this distance between centers in the ground plane."""
    min_recall: float = 0.1
    num_thresholds: int = 40
    """Recalls from `min_recall` to 1 for which scores are looked for."""
    sample_s: float = 0.5
    """What a sample counts in TID and LGD."""
    worst_amota: float = 0.0
    worst_amotp_m: float = 2.0
    worst_faf: float = 500.0
    worst_duration_s: float = 20.0
    """TID and LGD of a class of which nothing is found."""

    @property
    def matching(self) -> str:
        """What rows say of how boxes match."""
        return str(Match("bev", self.distance_m))


def center_distance(profile: str, match: Match) -> float:
    """Return the distance [m] of a match by centers in the ground plane. Raises ConfigError for any other match."""
    if match.kind != "bev":
        raise ConfigError(f"{profile} matches by center distance only, such as bev:2, not {match}")
    return match.threshold
