"""Coordinate frames of a log: their names and the tree of transforms between them."""

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import MAX_MAGNITUDE
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.transforms import inverse, pose_matrix, quaternion

BODY = "body"
BODIES = (BODY, "base_link", "base_footprint", "ego_vehicle", "ego")
"""What the body's coordinate frame is called, the first of these that is met on the way to the root."""
_MIN_QUATERNION, _MAX = 1e-100, 1e100  # Squares of what is smaller vanish, of what is larger overflow


@dataclass(frozen=True, eq=False)
class Edge:
    """The pose of a coordinate frame in its parent's."""

    parent: str
    translation_m: Float64  # (3,) [m]
    rotation_xyzw: Float64  # (4,) quaternion, as it was given

    def equals(self, other: "Edge") -> bool:
        """Tell whether both are the same, bit for bit."""
        pairs = (self.translation_m, other.translation_m), (self.rotation_xyzw, other.rotation_xyzw)
        return self.parent == other.parent and all(a.tobytes() == b.tobytes() for a, b in pairs)


def tree_of(rig: Rig) -> "TransformTree":
    """Return the tree of a rig: every sensor right on the body."""
    mounts = sorted(rig.mounts.items())
    return TransformTree({name: Edge(BODY, m.translation_m, m.rotation_xyzw) for name, m in mounts})


@dataclass
class TransformTree:
    """Transforms by child."""

    edges: dict[str, Edge] = field(default_factory=dict)

    def put(self, child: str, edge: Edge) -> bool:
        """Set the transform of a child; tells whether that is new."""
        old = self.edges.get(child)
        self.edges[child] = edge
        return old is None or not old.equals(edge)

    def path(self, frame: str) -> list[str]:
        """Coordinate frames from `frame` to its root. Raises DecodeError where the transforms form a loop."""
        path = [frame]
        while path[-1] in self.edges:
            parent = self.edges[path[-1]].parent
            if parent in path:
                raise DecodeError(f"transforms form a loop: {' → '.join([*path, parent])}")
            path.append(parent)
        return path

    def trace(self, frame: str) -> list[str]:
        """Coordinate frames from `frame` to its root; what comes before the transforms form a loop."""
        path = [frame]
        while path[-1] in self.edges and self.edges[path[-1]].parent not in path:
            path.append(self.edges[path[-1]].parent)
        return path

    def has_body(self, frame: str, body: str = "") -> bool:
        """Tell whether `frame` reaches `body`, or without a name a coordinate frame that is called like a body."""
        try:
            if body:
                return frame == body or self.pose(frame, body) is not None
            return self._body_on(self.path(frame)) is not None
        except DecodeError:
            return False

    def body(self, frames: list[str]) -> str | None:
        """Coordinate frame that counts as the body of sensors with these `frames`: the one that is called so, else the
        root of all; `None` without frames. Raises DecodeError where the transforms form a loop, or nothing links the
        frames with each other.
        """
        paths = [self.path(frame) for frame in frames]
        named = [name for name in map(self._body_on, paths) if name is not None]
        tops = sorted({self._body_on(path) or path[-1] for path in paths})
        if named:
            return min(named, key=BODIES.index)
        if len(tops) > 1:
            raise DecodeError(f"no transform links the coordinate frames {' and '.join(map(repr, tops))}")
        return tops[0] if tops else None

    def pose(self, frame: str, body: str) -> tuple[Float64, Float64] | None:
        """Translation (3,) and quaternion (4,) of `frame` in the body's; `None` where nothing links them.

        A direct transform is returned as it is stored, a chain is composed, also over a common parent; a sensor in the
        body's frame sits at 0. Raises DecodeError where the transforms form a loop, or one of them isn't finite or its
        quaternion zero.
        """
        path = self.path(frame)
        if frame == body:
            is_there = frame in BODIES or frame in self.edges or frame in {edge.parent for edge in self.edges.values()}
            return (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) if is_there else None
        if body not in path:  # beside the body, or above it
            down = self.path(body)
            common = next((name for name in path if name in down), None)
            if common is None:
                return None
            matrix = inverse(self._chain(down, common)) @ self._chain(path, common)
        elif (edge := self.edges[frame]).parent != body:
            matrix = self._chain(path, body)
        else:  # what is returned as it is stored may be of any length
            if why := invalid(edge.translation_m, edge.rotation_xyzw):
                raise DecodeError(f"transform of '{frame}' {why}")
            return edge.translation_m, edge.rotation_xyzw
        return matrix[:3, 3].copy(), quaternion(matrix[:3, :3])

    @staticmethod
    def _body_on(path: list[str]) -> str | None:
        return next((name for name in BODIES if name in path), None)

    def _chain(self, path: list[str], body: str) -> Float64:
        matrix = np.eye(4)
        for frame in path[: path.index(body)]:
            edge = self.edges[frame]
            if (why := invalid(edge.translation_m, edge.rotation_xyzw)) is not None:
                raise DecodeError(f"transform of '{frame}' {why}")
            matrix = pose_matrix(edge.translation_m, edge.rotation_xyzw) @ matrix
        return matrix


def invalid(translation_m: Float64, rotation_xyzw: Float64) -> str | None:
    """Tell what is wrong with a pose that can't be one."""
    if not np.abs(np.nan_to_num(translation_m, nan=np.inf)).max() < MAX_MAGNITUDE:
        return "isn't finite"
    largest = np.abs(np.nan_to_num(rotation_xyzw, nan=np.inf)).max()
    return None if _MIN_QUATERNION < largest < _MAX else "has no valid rotation"


def find_moved(first: TransformTree, body: str, later: Iterable[tuple[TransformTree, str]]) -> frozenset[str]:
    """Return the coordinate frames of the first transforms that later ones, with the name of the body in them, put
    elsewhere on the body, by more than 0.1 mm or 0.006 degrees.
    """
    found = set[str]()
    for tree, own in later:
        for name in first.edges:
            with suppress(DecodeError):
                before, after = first.pose(name, body), tree.pose(name, own)
                if before is not None and (after is None or not _are_near(pose_matrix(*before), pose_matrix(*after))):
                    found.add(name)
    return frozenset(found)


def _are_near(a: Float64, b: Float64) -> bool:
    return bool(np.allclose(a, b, rtol=0, atol=1e-4))


WORLDS = ("world", "map", "odom", "global", "earth")
"""What coordinate frames are called that stand still while the body moves."""


@dataclass(frozen=True, eq=False)
class CoordinateFrames:
    """The coordinate frames of a log as it begins."""

    rig: Rig
    tree: TransformTree
    body: str  # What the log calls the body's coordinate frame
    sensors: Mapping[str, str] = field(default_factory=dict)
    """Names of sensors by their coordinate frame, and by the topic of their messages."""
    world: str = ""  # Coordinate frame in which the log's poses are; empty: it isn't told
    camera0_is_body: bool = False
    """Whether the body's coordinates are those of KITTI's camera 0 with axes turned, as importers of KITTI have it."""
    moved: Callable[[], Collection[str]] = frozenset
    """Which of them lie elsewhere on the body later, by names of sensors, too; found when it is first asked for."""

    def body_T(self, name: str) -> Float64 | None:
        """Matrix (4, 4) that moves points from a coordinate frame, given by its name or that of a sensor, to the body;
        `None` where nothing links them. Raises DecodeError where the transforms form a loop.
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
        found = name if name in self.rig.kinds else self.sensors.get(name, "")
        return found if found in self.rig.sensors("camera") else None

    def only_camera(self) -> str | None:
        """Name of the camera where there is just one."""
        cameras = self.rig.sensors("camera")
        return cameras[0] if len(cameras) == 1 else None
