"""What names of coordinate frames and cameras mean in one log."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.replay.arrays import Float64
from fbench.replay.data import Rig
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.logs.tree import BODY, TransformTree

WORLDS = ("world", "map", "odom", "global", "earth")
"""What coordinate frames are called that stand still while the body moves."""


@dataclass(frozen=True, eq=False)
class CoordinateFrames:
    """The coordinate frames of a log as it begins."""

    rig: Rig
    tree: TransformTree
    body: str
    """What the log calls the body's coordinate frame."""
    sensors: Mapping[str, str] = field(default_factory=dict)
    """Names of sensors by their coordinate frame, and by the topic of their messages."""
    world: str = ""
    """Coordinate frame in which the log's poses are; empty: it isn't told."""
    camera0_is_body: bool = False
    """Whether the body's coordinates are those of KITTI's camera 0 with axes turned, as importers of KITTI have it."""

    def body_T(self, name: str) -> Float64 | None:
        """Matrix (4, 4) that moves points from a coordinate frame, given by its name or that of a sensor, to the body;
        `None` where nothing links them.

        Raises:
            DecodeError: where the transforms form a loop.
        """
        if name in ("", BODY, self.body):
            return pose_matrix([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
        if name in self.rig.mounts:
            return self.rig.body_T_sensor(name)
        pose = self.tree.pose(name, self.body)
        return None if pose is None else pose_matrix(*pose)

    def is_world(self, name: str) -> bool:
        """Tell whether a coordinate frame is that of the poses, which alone link it to the body; `world` always is."""
        return name == WORLDS[0] or (name == self.world if self.world else name in WORLDS)

    def camera(self, name: str) -> str | None:
        """Name of the camera that is called so, or has this coordinate frame or topic; `None` where none does."""
        found = name if name in self.rig.mounts else self.sensors.get(name, "")
        return found if found in self.rig.sensors("camera") else None

    def only_camera(self) -> str | None:
        """Name of the camera where there is just one."""
        cameras = self.rig.sensors("camera")
        return cameras[0] if len(cameras) == 1 else None
