"""Poses of the body from transforms that move, and from odometry."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

from fbench.replay.contracts.errors import DecodeError, LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.geometry.transforms import inverse, pose_matrix, quaternion
from fbench.replay.logs.container import Container
from fbench.replay.logs.coordinate_frames import Edge, TransformTree, invalid
from fbench.replay.logs.rig import RigState
from fbench.replay.logs.roles import Role

_MAX_SEARCHED = 2000  # So many messages are searched for the world


class TfPoses:
    """Composes the way from the body to the world, transform by transform; made anew for every pass over a log.

    `sensor` names the stream of poses; `tree` has the transforms that hold from the beginning, the static ones.
    """

    def __init__(self, sensor: str, tree: TransformTree, body: str, world: str) -> None:
        self._sensor, self._body, self._world = sensor, body, world
        self._tree = TransformTree(dict(tree.edges))

    def take(self, transforms: Sequence[tuple[str, Edge]], stamps_ns: Sequence[int], log_ns: int) -> Pose | None:
        """Take the transforms of one message, and return where the body is if any of them lies on the way to the world:
        at the newest of their stamps, else at `log_ns`. Raises DecodeError where the transforms form a loop, or one has
        no valid rotation.
        """
        for child, edge in transforms:
            self._tree.put(child, edge)
        path = self._tree.path(self._body)
        way = path[: path.index(self._world)] if self._world in path else []  # from the body to below the world
        on_it = [stamp for (child, _), stamp in zip(transforms, stamps_ns, strict=True) if child in way]
        pose = self._tree.pose(self._body, self._world) if on_it else None
        if pose is None:
            return None
        if (why := invalid(*pose)) is not None:
            raise DecodeError(f"transform of '{self._body}' {why}")
        return Pose(self._sensor, max(on_it) or log_ns, log_ns, *pose)


@dataclass(frozen=True)
class TfSource:
    """The topic with transforms that a user named for the poses of the body."""

    container: Container
    roles: Mapping[int, Role]
    topic: str
    state: Callable[[], RigState]  # What is known of coordinate frames as the log begins
    wanted: str = ""  # Coordinate frame of the world; empty: the one above all others

    @cached_property
    def channels(self) -> frozenset[int]:
        """Those of the topic; none where it holds no transforms."""
        transforms = (item for item in self.roles.items() if item[1].kind == "transform" and item[1].codec is not None)
        return frozenset(id_ for id_, role in transforms if role.topic == self.topic)

    @property
    def name(self) -> str:
        """What the stream of poses is called."""
        return self.topic.strip("/")

    def poses(self) -> TfPoses | None:
        """Begin a pass; `None` where the topic has no transforms. Raises LogError where none says where the body is."""
        if not self.channels:
            return None
        state = self.state()
        return TfPoses(self.name, state.tree, state.body(), self.world)

    @cached_property
    def world(self) -> str:
        """Coordinate frame above all others of the body, or the wanted one. Raises LogError where none links them."""
        state = self.state()
        tree, body = TransformTree(dict(state.tree.edges)), state.body()
        for entry in islice(self.container.entries(self.channels), _MAX_SEARCHED):
            codec = self.roles[entry.channel].codec
            if codec is not None and isinstance(entry.data, memoryview):
                with suppress(DecodeError):  # counted when it is read for good
                    for child, edge in codec.transforms(entry.data):
                        tree.put(child, edge)
        path = tree.path(body)
        world = self.wanted or path[-1]
        if world == body or world not in path:
            what = f"doesn't say where '{body}' is" + (f" in '{self.wanted}'" if self.wanted else "")
            raise LogError(f"{self.container.path}: topic '{self.topic}' {what}", "CAL001")
        return world


def of_body(pose: Pose, body_T_child: Float64) -> Pose:
    """Return the body's pose from that of a coordinate frame fixed to it. Raises DecodeError without valid rotation."""
    try:
        world_T_child = pose_matrix(pose.translation_m, pose.rotation_xyzw)
    except ValueError as error:
        raise DecodeError(f"pose has no valid rotation ({error})") from error
    world_T_body = world_T_child @ inverse(body_T_child)
    return replace(pose, translation_m=world_T_body[:3, 3].copy(), rotation_xyzw=quaternion(world_T_body[:3, :3]))
