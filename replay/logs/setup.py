"""What a user says about a log, beside what the log says itself."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fbench.replay.data import Kind
from fbench.replay.rig_patch import RigPatch

Doppler = Literal["receding", "approaching"]
EgoMotion = Literal["included", "removed"]


@dataclass(frozen=True)
class SensorSetup:
    """One sensor of a log."""

    topic: str
    kind: Kind
    frame: str = ""
    """Its coordinate frame; empty: as its messages say."""
    calibration: str = ""
    """Topic with the intrinsics of a camera; empty: as names and coordinate frames tell."""
    doppler: Doppler = "receding"
    """When recorded radial velocities are positive."""
    ego_motion: EgoMotion = "included"
    """Whether recorded radial velocities hold the vehicle's own motion."""
    velocity_period_mps: float | None = None
    """Radial velocities alias with this period [m/s]; 0: unambiguous; `None`: as the log says."""
    optional: bool = False
    """Whether a log may lack the topic."""


@dataclass(frozen=True)
class BoxSource:
    """A file or folder with boxes: ground truth, or results of another system."""

    path: Path
    format: str | None = None
    """One of `boxfiles.FORMATS`; `None`: as its names and content tell."""
    frame: str = ""
    """Coordinate frame of 3D boxes: `body`, `world`, that of a sensor; empty: as file or format say."""
    camera: str = ""
    """Camera of 2D boxes; empty: as the file says, else the only one."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Which topics are which sensors, and what else the log doesn't say."""

    sensors: Mapping[str, SensorSetup] = field(default_factory=dict)
    """By name: these and no others; empty: as the log says."""
    body: str = ""
    """Coordinate frame of the body; empty: as its name tells."""
    pose: str = ""
    """Topic with the poses of the body; empty: as the log says."""
    world: str = ""
    """Coordinate frame in which poses from transforms are wanted; empty: the one above all others."""
    rig: RigPatch = field(default_factory=RigPatch)
    truth_topics: tuple[str, ...] | None = None
    """Topics of ground truth; `None`: as their names tell."""
    result_topics: tuple[str, ...] = ()
    """Topics of another system's results."""
    truth: BoxSource | None = None
    """Ground truth instead of that of the log."""
    results: BoxSource | None = None
    classes: Mapping[str, str] = field(default_factory=dict)
    """Label of fbench, or `ignore`, for the name that a source gives to a class."""
    source: str = ""
    """Where this was read, for errors."""
