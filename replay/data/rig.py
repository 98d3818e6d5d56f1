"""The rig: sensors with their calibration, and what a log says about itself."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, TypeVar, get_args

import numpy as np

from fbench.replay.data.arrays import DIGESTED, Float64, freeze_fields
from fbench.replay.data.boxes import MAX_MAGNITUDE
from fbench.replay.data.metadata import Outline, Region, outline_of, regions_of
from fbench.replay.geometry.transforms import pose_matrix

Kind: TypeAlias = Literal["camera", "lidar", "radar"]
KINDS: Mapping[str, Kind] = {kind: kind for kind in get_args(Kind)}
"""Kinds of sensors by their names, to read what is only a text."""
T = TypeVar("T", "Mount", "CameraModel")


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
        pairs = (self.translation_m, other.translation_m), (self.rotation_xyzw, other.rotation_xyzw)
        return self.kind == other.kind and all(a.tobytes() == b.tobytes() for a, b in pairs)


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

    @property
    def is_sound(self) -> bool:
        """Whether all numbers can be those of a lens: finite, with a focal length."""
        values = np.concatenate([self.K.ravel(), self.distortion])
        return bool((np.abs(values) < MAX_MAGNITUDE).all() and self.K[0, 0] > 0 and self.K[1, 1] > 0)

    def equals(self, other: "CameraModel") -> bool:
        """Tell whether both are the same, bit for bit."""
        same = (self.size_wh, self.distortion_model) == (other.size_wh, other.distortion_model)
        pairs = (self.K, other.K), (self.distortion, other.distortion)
        return same and all(a.tobytes() == b.tobytes() for a, b in pairs)


@dataclass(frozen=True, eq=False)
class Rig:
    """The sensors of a vehicle with their calibration, by sensor name."""

    mounts: Mapping[str, Mount]
    cameras: Mapping[str, CameraModel]
    """Those whose intrinsics are known; of others only the images can be used."""
    bare: frozenset[str] = field(default=frozenset(), metadata={DIGESTED: False})
    """Cameras that have no mount, since nothing says where they are: only their images can be used."""

    @property
    def kinds(self) -> dict[str, Kind]:
        """Kind of each sensor by its name."""
        bare: dict[str, Kind] = dict.fromkeys(sorted(self.bare), "camera")
        return {**{name: mount.kind for name, mount in self.mounts.items()}, **bare}

    def body_T_sensor(self, sensor: str) -> Float64:
        """Matrix (4, 4) that moves points from the sensor's to body coordinates."""
        mount = self.mounts[sensor]
        return pose_matrix(mount.translation_m, mount.rotation_xyzw)

    def sensors(self, *kinds: Kind) -> tuple[str, ...]:
        """Names of all sensors of these kinds, sorted."""
        return tuple(sorted(name for name, kind in self.kinds.items() if kind in kinds))

    def without(self, sensors: Collection[str]) -> "Rig":
        """Return the rig without some of its sensors."""
        return Rig(
            {name: mount for name, mount in self.mounts.items() if name not in sensors},
            {name: camera for name, camera in self.cameras.items() if name not in sensors},
            self.bare - frozenset(sensors),
        )

    def list_changes(self, old: "Rig") -> tuple[str, ...]:
        """Names of the sensors whose mount or camera model isn't the same as in `old`, bit for bit; sorted."""

        def same(a: T | None, b: T | None) -> bool:
            return a is b if a is None or b is None else a.equals(b)

        names = sorted({*self.mounts, *self.cameras, *old.mounts, *old.cameras})
        mounts = {name for name in names if not same(self.mounts.get(name), old.mounts.get(name))}
        cameras = {name for name in names if not same(self.cameras.get(name), old.cameras.get(name))}
        return tuple(sorted(mounts | cameras))


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
        """Where road users are expected, in world coordinates. Raises LogError where metadata have another form."""
        return regions_of(self.metadata)

    @property
    def outline(self) -> Outline:
        """How far the vehicle reaches. Raises LogError where metadata have no lengths."""
        return outline_of(self.metadata)


@dataclass(frozen=True)
class LogSpan:
    """When the messages of a log were recorded."""

    first_ns: int
    last_ns: int
    period_ns: Mapping[str, int] = field(default_factory=dict)  # Median, by sensor
