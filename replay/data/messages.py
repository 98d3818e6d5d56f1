"""Messages: one measurement of one sensor, and ground truth of one instant.

Frozen dataclasses over read-only numpy arrays; shapes are checked once, when an object is made.
Time is `int` nanoseconds. Body: x forward, y left, z up; camera: x right, y down, z forward.
Lengths m, angles rad, image px with pixel centers at integers.
"""

from dataclasses import dataclass, field
from typing import TypeAlias

from fbench.replay.data.arrays import DIGESTED, Array, Float32, Float64, freeze_fields
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.video import VideoPicture
from fbench.replay.geometry.transforms import pose_matrix


@dataclass(frozen=True, eq=False)
class Image:
    """One camera image, encoded as it was recorded."""

    sensor: str
    stamp_ns: int
    """When it was measured."""
    log_ns: int
    """When it was recorded, that is arrived."""
    data: bytes
    encoding: str
    """`jpeg`, `png`, `webp`; `h264`, `h265`, `vp9`, `av1` for one picture of a video; or a raw layout of
    `data.images.LAYOUTS`: `rgb8`, `mono16`, `bayer_rggb8`, `uyvy` ...; rows without padding, 16 bits little-endian."""
    size_wh: tuple[int, int]
    """Width and height [px]."""
    frame_number: int | None = None
    """Number of the frame that the recorder gave to all messages of one instant, where it did."""
    video: VideoPicture | None = field(default=None, repr=False, metadata={DIGESTED: False})
    """How the picture of a video is decoded, which takes more than its own data."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """One LiDAR sweep, in the sensor's coordinate frame."""

    sensor: str
    stamp_ns: int
    log_ns: int
    xyz: Float32
    """(N, 3) [m]."""
    intensity: Float32 | None = None
    """(N,) as the sensor gives it."""
    ring: Array | None = None
    """(N,) uint16, laser number."""
    offset_ns: Array | None = None
    """(N,) int32 [ns], time of each point after `stamp_ns`."""
    frame_number: int | None = None

    def __post_init__(self) -> None:
        one = ("N",)
        freeze_fields(self, xyz=("f4", ("N", 3)), intensity=("f4", one), ring=("u2", one), offset_ns=("i4", one))


@dataclass(frozen=True, eq=False)
class RadarScan:
    """One radar scan, in the sensor's coordinate frame."""

    sensor: str
    stamp_ns: int
    log_ns: int
    xyz: Float32
    """(N, 3) [m]."""
    radial_velocity_mps: Float32 | None = None
    """(N,) [m/s], positive when receding, relative to the sensor as measured (ego motion not removed)."""
    rcs_dbsm: Float32 | None = None
    """(N,) [dBsm]; some sensors give an uncalibrated magnitude [dB], which the log's metadata then say."""
    range_m: Float32 | None = None
    azimuth_rad: Float32 | None = None
    altitude_rad: Float32 | None = None
    frame_number: int | None = None

    def __post_init__(self) -> None:
        one = ("f4", ("N",))
        polar = {"range_m": one, "azimuth_rad": one, "altitude_rad": one}
        freeze_fields(self, xyz=("f4", ("N", 3)), radial_velocity_mps=one, rcs_dbsm=one, **polar)


@dataclass(frozen=True, eq=False)
class Pose:
    """The body's pose in the world at one instant."""

    sensor: str
    stamp_ns: int
    log_ns: int
    translation_m: Float64
    """(3,) [m] of the body in the world."""
    rotation_xyzw: Float64
    """(4,) quaternion, as it was given."""
    frame_number: int | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, translation_m=("f8", (3,)), rotation_xyzw=("f8", (4,)))

    @property
    def world_T_body(self) -> Float64:
        """Matrix (4, 4) that moves points from body to world."""
        return pose_matrix(self.translation_m, self.rotation_xyzw)


Message: TypeAlias = Image | PointCloud | RadarScan | Pose


@dataclass(frozen=True, eq=False)
class Tick:
    """An instant that only boxes tell of: opens a frame in a log that has no message of any sensor."""

    sensor: str
    """`BOXES`, in the place of a reference sensor."""
    stamp_ns: int
    log_ns: int
    frame_number: int | None = None


BOXES = "boxes"


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth at one instant, or in the same form what another system found there; `None` means not labeled,
    empty boxes mean that nothing was there.
    """

    stamp_ns: int
    log_ns: int
    boxes3d: Boxes3D | None = None
    """In body coordinates at `stamp_ns`, or in those of the world."""
    boxes2d: Boxes2D | None = None
    frame_number: int | None = None
    frame_index: int | None = None
    """Which frame is meant, where a file counts frames and gives no stamps; `stamp_ns` is 0 then."""
    in_world: bool = False
    """Whether 3D boxes are in world coordinates: only the pose at the frame's instant can move them."""
