"""Parameters of fusion in images."""

from dataclasses import dataclass

from fbench.pipelines.checks import require_ranges


@dataclass(frozen=True)
class ImageFusionParams:
    """How boxes of several sensors in one image become one, and how sure that makes us.

    Each sensor that sees an object says with which probability it is one; probabilities are joined as those of
    independent witnesses. Sensors that could see it and don't have a factor on its odds.
    """

    camera_share: float = 0.25
    """Of cameras, boxes down to this share of their `min_score` are used where LiDAR or radar confirm them [0 to 1]."""
    min_similarity: float = 0.25
    """Least overlap times agreement in depth of two boxes that show one object [0 to 1]."""
    prior: float = 0.3
    """How likely an object is before any sensor looks [0 to 1]; the lower, the more it means that two agree."""
    lidar_weight: float = 0.75
    """Probability of what looks fully like a vehicle to LiDAR, as it alone tells [0 to 1]."""
    radar_weight: float = 0.7
    """The same for radar."""
    points_factor: float = 1.6
    """Factor on the odds of an object where many points lie in the camera's box, at about its distance, that are no
    object themselves; nearer to 1 for few."""
    measured_share: float = 0.2
    """By so much the outline of a camera that is sure is drawn towards that of the points [0 to 1]."""
    weak_measured_share: float = 1.0
    """The same where the camera is least sure; in proportion between."""
    unseen_by_camera: float = 0.1
    """Factor on the odds of an object that a working camera ought to see and doesn't, where cameras see everything
    that LiDAR and radar see; nearer to 1 the less they saw of that lately, as by night."""
    camera_size_px: float = 40.0
    """Of objects whose box has an area of n x n pixels a camera that sees well sees the share 1 - exp(-n / this)."""
    unseen_by_rays: float = 0.25
    """The same for LiDAR and radar, where their rays go on behind the object."""
    through: float = 0.6
    """Share of the rays through the middle of a box that go on behind the object, from which on it counts as unseen."""
    min_score: float = 0.5
    """Objects that are less likely are dropped."""

    def __post_init__(self) -> None:
        names = (
            "camera_share", "min_similarity", "prior", "lidar_weight", "radar_weight", "measured_share",
            "weak_measured_share", "unseen_by_camera", "unseen_by_rays", "through", "min_score",
        )  # fmt: skip
        others = {"points_factor": (1.0, 1000.0), "camera_size_px": (0.1, 1e5)}
        require_ranges("fusion", self, dict.fromkeys(names, (0.0, 1.0)) | others)
