"""Parameters of late fusion."""

from dataclasses import dataclass

from fbench.pipelines.checks import require_ranges


@dataclass(frozen=True)
class FusionParams:
    """How objects that several sensors see become one, and how sure that makes us.

    Scores are joined as 1 - product of (1 - weight * score): independent sensors, each of which can be wrong.
    """

    camera_weight: float = 0.6
    """How far the camera alone is believed [0 to 1], where LiDAR or radar deliver."""
    lidar_weight: float = 0.9
    """How far the LiDAR alone is believed [0 to 1]."""
    radar_weight: float = 0.93
    """How far the radar alone is believed about moving objects [0 to 1]."""
    standing_weight: float = 0.4
    """How far stationary radar echoes at the place of a camera's box, and clusters of echoes without velocity, are
    believed [0 to 1]."""
    unseen_factor: float = 0.5
    """Factor on the score of an object that a working camera ought to see and doesn't."""
    min_score: float = 0.6
    """Objects with a lower score are dropped."""
    gate: float = 2.5
    """Largest difference between a point's distance and that guessed from the image, in standard deviations."""
    tilt_std_rad: float = 0.006
    """Error of the ground's tilt against the camera [rad], for distances from the lower edge of a camera's box."""
    min_range_std: float = 0.09
    """Least relative error of distances guessed from the image."""
    lidar_std_m: float = 0.4
    """Error of the distance of a vehicle's near side by LiDAR [m]."""
    radar_std_m: float = 0.8
    """Error of the distance of a moving vehicle's near side by radar [m]."""
    standing_std_m: float = 1.5
    """Error of the distance of stationary objects by radar [m]."""
    bearing_margin_px: float = 30.0
    """Echoes this far beside a camera's box [px] may belong to it: radar is poor at angles."""
    merge_m: float = 3.0
    """Objects of different sensors with centres nearer than this [m] are one."""

    def __post_init__(self) -> None:
        shares = ("camera_weight", "lidar_weight", "radar_weight", "standing_weight", "unseen_factor", "min_score")
        require_ranges("fusion", self, dict.fromkeys(shares, (0.0, 1.0)))
        require_ranges("fusion", self, dict.fromkeys(("lidar_std_m", "radar_std_m", "standing_std_m"), (0.01, 100.0)))
        ranges = {
            "gate": (0.1, 100.0), "tilt_std_rad": (1e-6, 1.0), "min_range_std": (0.001, 10.0),
            "bearing_margin_px": (0.0, 10_000.0), "merge_m": (0.0, 100.0),
        }  # fmt: skip
        require_ranges("fusion", self, ranges)
