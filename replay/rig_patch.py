"""Calibration that comes from elsewhere and goes before what a log says."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.replay.data import CameraModel
from fbench.replay.logs.tree import Edge


@dataclass(frozen=True, eq=False)
class RigPatch:
    """Transforms and intrinsics by name: that of a sensor, or of a coordinate frame."""

    edges: Mapping[str, Edge] = field(default_factory=dict)
    """Pose of each named child in its parent; parents are named likewise, `body` being the body."""
    cameras: Mapping[str, CameraModel] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic of the messages of a name, where the file tells it (`rostopic` of Kalibr): another way to find a sensor."""
    places: Mapping[str, str] = field(default_factory=dict)
    """For errors: which file each name comes from."""
    moving: Mapping[str, str] = field(default_factory=dict)
    """Children whose pose a file can't tell, and why: `joint 'pan' (revolute)`. The log may."""

    def over(self, other: "RigPatch") -> "RigPatch":
        """Return both, this one going first where they name the same."""
        return RigPatch(
            {**other.edges, **self.edges}, {**other.cameras, **self.cameras}, {**other.topics, **self.topics},
            {**other.places, **self.places}, {**other.moving, **self.moving},
        )  # fmt: skip
