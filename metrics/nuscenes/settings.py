"""Everything that the nuScenes benchmarks fix, as data; nuscenes-devkit 1.2.0, eval/*/configs."""

from dataclasses import dataclass

from fbench.metrics.nuscenes.rules import DETECTION_RULES, TRACKING_RULES, BoxRules
from fbench.metrics.profile import Match


@dataclass(frozen=True)
class DetectionSettings:
    """`detection_cvpr_2019.json`"""

    rules: BoxRules = DETECTION_RULES
    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """Boxes match below each of these distances between centres in the ground plane."""
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
    """Boxes match below this distance between centres in the ground plane."""
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
