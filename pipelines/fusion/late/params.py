"""Parameters of late fusion."""

from dataclasses import dataclass, field

from fbench.pipelines.params import require_ranges

_SHARES = (
    "prior", "lidar_weight", "ruled_weight", "radar_weight", "standing_weight", "confirmed_lidar",
    "confirmed_radar", "camera_share", "min_score", "max_detection", "unlikely",
)  # fmt: skip


@dataclass(frozen=True)
class AssociationParams:
    """Which measurements of different sensors are taken for one object.

    Each pair of them has a log-likelihood ratio: how likely their difference is for one object against for two that
    have nothing to do with each other, of which there is one in so many square metres.
    """

    lidar_area_m2: float = 100.0
    """Area [m²] in which one cluster of LiDAR points that is no part of the object is expected."""
    radar_area_m2: float = 2000.0
    """The same for a cluster of radar echoes."""
    camera_area_m2: float = 500.0
    """The same for what another camera sees."""
    edge_std_px: float = 1.5
    """Error of the edges of a camera's box [px]."""
    tilt_std_rad: float = 0.004
    """Error of the ground's tilt against the camera [rad], for distances from the lower edge of a camera's box."""
    min_range_std: float = 0.09
    """Least relative error of distances guessed from the image."""
    bearing_std_rad: float = 0.01
    """Error of a camera box's direction [rad], beside a share of its width."""
    lidar_std_m: float = 0.4
    """Error of the near side of an object by LiDAR [m]."""
    radar_std_m: float = 0.8
    """Error of the near side of a moving object by radar, along the line of sight [m]."""
    radar_bearing_std_rad: float = 0.03
    """Error of a radar cluster's direction [rad]."""
    standing_std_m: float = 1.5
    """Error of the distance of stationary objects by radar [m]."""
    bearing_margin_px: float = 30.0
    """Echoes this far beside a camera's box [px] may belong to it: radar is poor at angles."""
    least_inside: float = 0.6
    """A LiDAR cluster of which less than this share lies in a camera's box, and that doesn't look like a vehicle, is
    cut: what is inside may belong to what the camera sees, and the rest to others."""

    def __post_init__(self) -> None:
        areas = ("lidar_area_m2", "radar_area_m2", "camera_area_m2")
        stds = ("lidar_std_m", "radar_std_m", "standing_std_m")
        ranges = {
            **dict.fromkeys(areas, (0.01, 1e6)), **dict.fromkeys(stds, (0.01, 100.0)),
            "edge_std_px": (0.0, 1000.0), "tilt_std_rad": (1e-6, 1.0), "min_range_std": (0.001, 10.0),
            "bearing_std_rad": (1e-4, 1.0), "radar_bearing_std_rad": (1e-4, 1.0),
            "bearing_margin_px": (0.0, 10_000.0), "least_inside": (0.0, 1.0),
        }  # fmt: skip
        require_ranges("fusion.association", self, ranges)


@dataclass(frozen=True)
class AgreementParams:
    """How well each sensor works right now: the share of objects which others are sure of that it sees, too.

    Nobody tells the weather: a camera that sees little of what LiDAR and radar see is worth little, and what it
    doesn't see may be there all the same. Shares are kept apart for near and far objects.
    """

    camera: float = 0.8
    """Share of the objects in view that a camera is expected to see before anything is known."""
    lidar: float = 0.9
    """The same of LiDAR."""
    radar: float = 0.4
    """The same of radar, which sees what moves."""
    weight: float = 4.0
    """So many objects make what was seen weigh as much as the expectation."""
    frames: float = 30.0
    """After so many frames what was seen counts 1/e."""
    band_m: float = 15.0
    """Width of the bands of distance [m]; the fourth has no end."""

    def __post_init__(self) -> None:
        ranges = dict.fromkeys(("camera", "lidar", "radar"), (0.0, 1.0))
        ranges |= {"weight": (0.01, 1e6), "frames": (0.1, 1e6), "band_m": (0.1, 1000.0)}
        require_ranges("fusion.agreement", self, ranges)


@dataclass(frozen=True)
class FusionParams:
    """How objects that several sensors see become one, and how sure that makes us.

    The log-odds that an object exists are those of `prior`; each sensor that sees it adds how much surer it is than
    that, and each that doesn't see it log(1 - the probability that it would).
    """

    association: AssociationParams = field(default_factory=AssociationParams)
    """What belongs together."""
    agreement: AgreementParams = field(default_factory=AgreementParams)
    """How well the sensors work."""
    camera_share: float = 0.5
    """Boxes down to this share of a camera's `min_score` [0 to 1] count where LiDAR or moving echoes confirm them."""
    prior: float = 0.13
    """Probability of an object where nothing is known [0 to 1]; the lower, the more it says that several sensors see
    one."""
    overlap: float = 3.0
    """Times how far the IoU of an object that LiDAR places, projected, with the camera's box is above 0.5: what it adds
    to the log-odds."""
    lidar_weight: float = 1.0
    """How far a LiDAR cluster's score is believed [0 to 1] where it is a probability (`lidar.judge=model`)."""
    ruled_weight: float = 0.5
    """The same where rules give it: what looks like a car by them is often something else."""
    radar_weight: float = 0.8
    """How far the score of moving echoes is believed [0 to 1]."""
    standing_weight: float = 0.19
    """How far stationary echoes at the place of what only cameras see, and clusters of echoes without velocity, are
    believed [0 to 1]."""
    confirmed_lidar: float = 0.19
    """Probability that many LiDAR points where a camera sees an object belong to one, whatever their shape [0 to
    1]."""
    confirmed_radar: float = 0.66
    """The same of moving echoes [0 to 1]."""
    unlikely: float = 0.2
    """What a radar or camera reports where something hides it from view is believed as if it saw this share of such
    objects [0 to 1]: most of it are mirrored images, or aren't there."""
    full_points: float = 8.0
    """Of n points 1 - exp(-n / this) of that is believed."""
    camera_height_px: float = 12.0
    """Height [px] at which a camera sees every second object."""
    lidar_half_m: float = 40.0
    """Distance [m] at which every second object has enough LiDAR points to be found."""
    max_range_m: float = 60.0
    """LiDAR and radar aren't expected to see farther objects [m]."""
    max_detection: float = 0.95
    """No sensor sees more than this share of what it could [0 to 1]."""
    min_score: float = 0.4
    """Objects with a lower probability are dropped."""

    def __post_init__(self) -> None:
        require_ranges("fusion", self, {**dict.fromkeys(_SHARES, (0.0, 1.0)), "unlikely": (1e-6, 1.0)})
        ranges = {"full_points": (0.1, 1e6), "camera_height_px": (0.1, 10_000.0), "max_range_m": (1.0, 1000.0),
                  "lidar_half_m": (1.0, 1e6), "overlap": (0.0, 100.0)}  # fmt: skip
        require_ranges("fusion", self, ranges)
