"""The calibration of one log: its rig as the log begins, changes of it, coordinate frames, and poses by transforms."""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import KINDS, Rig
from fbench.replay.logs.container import Container
from fbench.replay.logs.coordinate_frames import BODY, CoordinateFrames, TransformTree, find_moved, tree_of
from fbench.replay.logs.poses import TfSource
from fbench.replay.logs.rig import RigChanges, RigState, first_state
from fbench.replay.logs.rig_patch import find_sensors, rename_sensors, require_use
from fbench.replay.logs.roles import Role, sensor_roles
from fbench.replay.logs.setup import Setup
from fbench.replay.logs.truth import PosesIn

_SAME_CLOCK_NS = 3_600_000_000_000  # A stamp farther from the log times of changes is of another clock


@dataclass(frozen=True)
class LogCalibration:
    """What a log and its user say about sensors and coordinate frames; read when it is first asked for."""

    container: Container
    roles: Mapping[int, Role]
    left_out: frozenset[str]
    setup: Setup
    metadata: Mapping[str, str]

    @cached_property
    def rig(self) -> Rig:
        """Sensors as the log begins. Raises LogError naming one without transform or calibration."""
        return self._container_rigs[0][1] if self.container.rigs else self._state.rig()

    @cached_property
    def coordinate_frames(self) -> CoordinateFrames:
        """What names of coordinate frames and cameras mean here. Raises LogError where the rig is incomplete."""
        heard = sensor_roles(self.roles)
        names = {role.frame_id: role.sensor for role in heard} | {role.topic: role.sensor for role in heard}
        world, is_camera0 = self.poses_in.world, self.metadata.get(CAMERA0) == BODY
        return CoordinateFrames(self.rig, *self.tree(), names, world, is_camera0, lambda: self._moved)

    def tree(self, at_ns: tuple[int, int] | None = None) -> tuple[TransformTree, str]:
        """Return the transforms that hold at a stamp with its log time, or as the log begins, and the name of the body
        in them. Boxes may be recorded long after their stamp, which counts unless it is of another clock.
        """
        if at_ns is not None and self._later:
            stamp_ns, log_ns = at_ns
            is_of_log = abs(stamp_ns - self._later[0][0]) < _SAME_CLOCK_NS
            num = bisect_right(self._later, min(at_ns) if is_of_log else log_ns, key=lambda later: later[0])
            if num:
                return self._later[num - 1][1:]
        if self.container.rigs:
            return tree_of(self.rig), BODY
        return self._state.tree, self._state.body()

    @cached_property
    def _later(self) -> Sequence[tuple[int, TransformTree, str]]:
        """Transforms that hold from a log time on, in that order; these alone are read for it."""
        if self.container.rigs:
            return [(log_ns, tree_of(rig), BODY) for log_ns, rig in self._container_rigs[1:]]
        return list(self._state.later_trees())

    @cached_property
    def _moved(self) -> frozenset[str]:
        """Coordinate frames that don't lie on the body as they did when the log began, and sensors that have one."""
        first, body = self.tree()
        found = find_moved(first, body, (later[1:] for later in self._later))
        return found | {role.sensor for role in sensor_roles(self.roles) if role.frame_id in found}

    @cached_property
    def tf(self) -> TfSource:
        """The topic with transforms that poses come from."""
        return TfSource(self.container, self.roles, self.setup.pose, lambda: self._state, self.setup.world)

    @cached_property
    def poses_in(self) -> PosesIn:
        """Whether there are poses, and in which coordinate frame."""
        if self.tf.channels:
            return PosesIn(are_there=True, world=self.tf.world)
        worlds = [role.world for _, role in sorted(self.roles.items()) if role.kind == "pose"]
        return PosesIn(bool(worlds), next(iter(worlds), ""))

    def changes(self) -> RigChanges:
        """Begin to follow the changes of the rig; messages can be read even where there is no rig."""
        rig: Rig | None = None
        with suppress(LogError):
            rig = self.rig
        return RigChanges(rig, self._container_rigs[1:], None if self.container.rigs else self._state)

    @cached_property
    def _state(self) -> RigState:
        return first_state(self.container, self.roles, self.left_out, self.setup)

    @cached_property
    def _container_rigs(self) -> list[tuple[int, Rig]]:
        """Rigs that the container itself holds, as the setup wants them."""
        return [(log_ns, self._arrange(rig)) for log_ns, rig in self.container.rigs]

    def _arrange(self, rig: Rig) -> Rig:
        heard = sensor_roles(self.roles)
        rig = rename_sensors(rig, {role.frame_id: role.sensor for role in heard}) if self.setup.sensors else rig
        patch = find_sensors(self.setup.rig, self.roles)
        require_use(self.setup.rig, patch, self.roles, patch.tree(tree_of(rig), BODY))
        rig = patch.on(rig, {role.sensor: KINDS[role.kind] for role in heard})
        bare = frozenset(role.sensor for role in heard if role.kind == "camera") - frozenset(rig.mounts)
        return replace(rig, bare=bare).without(self.left_out)
