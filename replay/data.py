"""The data types of fbench: messages of sensors, boxes, rig, frames and outputs.

Frozen dataclasses over read-only numpy arrays; shapes are checked once, when an object is made.
Time is `int` nanoseconds. Body: x forward, y left, z up; camera: x right, y down, z forward.
Lengths m, angles rad, image px with pixel centres at integers.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal, TypeAlias, TypeVar, get_args

import numpy as np

from fbench.replay.arrays import Array, Bool, Float32, Float64, Int64, Text, freeze_fields
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.errors import DataError
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.regions import Region, regions_of

__all__ = [
    "KINDS", "LABELS", "VEHICLES", "Bool", "Boxes", "Boxes2D", "Boxes3D", "CameraModel", "ClockName", "Fault",
    "Float32", "Float64", "Frame", "Image", "Int64", "Kind", "LogInfo", "Message", "Mount", "Output",
    "PointCloud", "Pose", "RadarScan", "Region", "Rig", "RigChange", "Source", "Text", "Truth",
]  # fmt: skip

LABELS = ("car", "van", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "other")
VEHICLES = ("car", "van", "truck", "bus", "trailer", "motorcycle")

Kind: TypeAlias = Literal["camera", "lidar", "radar"]
Boxes: TypeAlias = Boxes2D | Boxes3D
ClockName: TypeAlias = Literal["host", "log"]
"""Whose time latencies are measured in: that of this machine, or that of the log."""
KINDS: Mapping[str, Kind] = {kind: kind for kind in get_args(Kind)}
"""Kinds of sensors by their names, to read what is only a text."""
T = TypeVar("T", "Mount", "CameraModel")


class Source(IntFlag):
    """Which sensors contributed to a box."""

    C = 1
    L = 2
    R = 4
    S = 8


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
    """`jpeg`, `png`, `webp`, or a raw layout of `raw_images.LAYOUTS`: `rgb8`, `mono16`, `bayer_rggb8`, `uyvy` ...;
    rows without padding, 16 bits little-endian."""
    size_wh: tuple[int, int]
    """Width and height [px]."""
    frame_number: int | None = None
    """Number of the frame that the recorder gave to all messages of one instant, where it did."""


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
        freeze_fields(
            self,
            xyz=("f4", ("N", 3)),
            intensity=("f4", ("N",)),
            ring=("u2", ("N",)),
            offset_ns=("i4", ("N",)),
        )


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
        freeze_fields(
            self,
            xyz=("f4", ("N", 3)),
            radial_velocity_mps=one,
            rcs_dbsm=one,
            range_m=one,
            azimuth_rad=one,
            altitude_rad=one,
        )


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
    """Ground truth at one instant, or in the same form what another system found there; `None` means not labelled,
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


@dataclass(frozen=True, eq=False)
class Mount:
    """Where a sensor sits on the body: the sensor's pose in body coordinates, as it was given."""

    kind: Kind
    translation_m: Float64
    """(3,) [m]."""
    rotation_xyzw: Float64
    """(4,) quaternion."""

    def __post_init__(self) -> None:
        freeze_fields(self, translation_m=("f8", (3,)), rotation_xyzw=("f8", (4,)))

    def equals(self, other: "Mount") -> bool:
        """Tell whether both are the same, bit for bit."""
        return (self.kind, self.translation_m.tobytes(), self.rotation_xyzw.tobytes()) == (
            other.kind, other.translation_m.tobytes(), other.rotation_xyzw.tobytes(),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of one camera: u = K [x/z, y/z, 1] for undistorted rays."""

    K: Float64
    """(3, 3) [px]."""
    size_wh: tuple[int, int]
    distortion_model: str = ""
    """As in ROS: `plumb_bob`, `rational_polynomial`, `fisheye`; empty: none."""
    distortion: Float64 = field(default_factory=lambda: np.zeros(0))
    """(M,) coefficients."""

    def __post_init__(self) -> None:
        freeze_fields(self, K=("f8", (3, 3)), distortion=("f8", ("M",)))

    def equals(self, other: "CameraModel") -> bool:
        """Tell whether both are the same, bit for bit."""
        return (self.size_wh, self.distortion_model, self.K.tobytes(), self.distortion.tobytes()) == (
            other.size_wh, other.distortion_model, other.K.tobytes(), other.distortion.tobytes(),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rig:
    """The sensors of a vehicle with their calibration, by sensor name."""

    mounts: Mapping[str, Mount]
    cameras: Mapping[str, CameraModel]

    def body_T_sensor(self, sensor: str) -> Float64:
        """Matrix (4, 4) that moves points from the sensor's to body coordinates."""
        mount = self.mounts[sensor]
        return pose_matrix(mount.translation_m, mount.rotation_xyzw)

    def sensors(self, *kinds: Kind) -> tuple[str, ...]:
        """Names of all sensors of these kinds, sorted."""
        return tuple(sorted(name for name, mount in self.mounts.items() if mount.kind in kinds))

    def without(self, sensors: Collection[str]) -> "Rig":
        """Return the rig without some of its sensors."""
        return Rig(
            {name: mount for name, mount in self.mounts.items() if name not in sensors},
            {name: camera for name, camera in self.cameras.items() if name not in sensors},
        )

    def changed_since(self, old: "Rig") -> tuple[str, ...]:
        """Names of the sensors whose mount or camera model isn't the same as in `old`, bit for bit; sorted."""
        names = sorted({*self.mounts, *self.cameras, *old.mounts, *old.cameras})
        return tuple(
            name
            for name in names
            if not _same(self.mounts.get(name), old.mounts.get(name))
            or not _same(self.cameras.get(name), old.cameras.get(name))
        )


def _same(a: T | None, b: T | None) -> bool:
    return a is b if a is None or b is None else a.equals(b)


@dataclass(frozen=True, eq=False)
class RigChange:
    """From here on another rig holds; comes between the messages of a log."""

    log_ns: int
    rig: Rig
    sensors: tuple[str, ...]
    """Whose calibration changed."""

    @property
    def reason(self) -> str:
        """Why a segment ends here."""
        return f"calibration of {', '.join(self.sensors)} changes"


@dataclass(frozen=True)
class LogInfo:
    """What a log says about itself."""

    name: str
    """File name without folder and suffix."""
    log_id: str
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def regions(self) -> tuple[Region, ...]:
        """Where road users are expected, in world coordinates; none where the log doesn't say.

        Raises:
            LogError: where the metadata say it in another form than ours.
        """
        return regions_of(self.metadata)


@dataclass(frozen=True, eq=False)
class Frame:
    """The messages of all sensors that belong to one instant."""

    index: int
    stamp_ns: int
    segment: int
    messages: Mapping[str, Message]
    """By sensor name."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Why an expected sensor isn't there, by sensor name."""
    frame_number: int | None = None


@dataclass(frozen=True)
class Fault:
    """Something wrong with the data of one frame that a pipeline met: a code of the fault table, and where."""

    code: str
    where: str


@dataclass(frozen=True, eq=False)
class Output:
    """What a pipeline makes of one frame: boxes in body coordinates (3D) or in images (2D)."""

    detections: Boxes
    tracks: Boxes
    stage_ns: Mapping[str, int]
    """Time of each stage [ns], in the order in which they ran."""
    faults: tuple[Fault, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    """Sensors that the pipeline could have used but couldn't, with the reason: a camera without weights."""
    clock: ClockName = "host"
    """`log` where the pipeline only passes on what was computed elsewhere: then the times of the stages are log times
    that follow the frame's instant and add up to the latency, which is unknown without any; what the step took says
    nothing. Else they are wall times within the step.
    """

    def __post_init__(self) -> None:
        if type(self.detections) is not type(self.tracks):
            raise DataError(
                f"Output.tracks: expected {type(self.detections).__name__}, got {type(self.tracks).__name__}"
            )
