"""Parameters of fusion in images."""

from dataclasses import dataclass

from fbench.pipelines.checks import require_ranges


@dataclass(frozen=True)
class ImageFusionParams:
    """How boxes of several sensors in one image become one, and how sure that makes us.

    Scores are joined as 1 - product of (1 - weight * score): independent sensors, each of which can be wrong. Then
    each sensor that could see the object and doesn't has a factor.
    """

    min_similarity: float = 0.25
    """Least overlap times agreement in depth of two boxes that show one object [0 to 1]."""
    camera_weight: float = 0.95
    """How far the camera alone is believed [0 to 1]."""
    lidar_weight: float = 0.6
    """How far the LiDAR alone is believed [0 to 1]."""
    radar_weight: float = 0.6
    """How far the radar alone is believed [0 to 1]."""
    points_weight: float = 0.6
    """How far points are believed that lie in a camera's box at about its distance and form no object themselves."""
    measured_share: float = 0.2
    """By so much a camera's outline is drawn towards that of the points [0 to 1]."""
    unseen_by_camera: float = 0.5
    """Factor on the score of an object that a working camera ought to see and doesn't, where cameras see everything
    that LiDAR and radar see; nearer to 1 the less they saw of that lately, as by night."""
    unseen_by_rays: float = 0.5
    """The same for LiDAR and radar, where their rays go on behind the object."""
    through: float = 0.6
    """Share of the rays through the middle of a box that go on behind the object, from which on it counts as unseen."""
    min_score: float = 0.6
    """Objects with a lower score are dropped."""

    def __post_init__(self) -> None:
        names = (
            "min_similarity", "camera_weight", "lidar_weight", "radar_weight", "points_weight", "measured_share",
            "unseen_by_camera", "unseen_by_rays", "through", "min_score",
        )  # fmt: skip
        require_ranges("fusion", self, dict.fromkeys(names, (0.0, 1.0)))


def late_fusion() -> ImageFusionParams:
    """Parameters of fusion where LiDAR and radar detect in space: outlines of such boxes in the image are poorer."""
    return ImageFusionParams(measured_share=0.15)
