"""Cameras, and two other kinds of sensors beside them: what all of them see in one frame."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from fbench.pipelines.branches import Branches
from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Fault, Frame, LogInfo, Rig
from fbench.replay.sensor_settings import SensorSettings

A = TypeVar("A")
B = TypeVar("B")


class SideBySide:
    """Runs the branches of a pipeline that merges cameras with two other kinds of sensors."""

    def __init__(self, cameras: CameraStage) -> None:
        self._cameras, self._branches = cameras, Branches()

    @property
    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    @property
    def missing(self) -> Mapping[str, str]:
        """Cameras of the rig that aren't used, with the reason."""
        return self._cameras.missing

    def start(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig.

        Raises:
            LogError: where one that is used can't be projected into.
        """
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()

    def view(
        self,
        frame: Frame,
        clock: StageClock,
        faults: list[Fault],
        a: Callable[[Frame, StageClock], A],
        b: Callable[[Frame, StageClock], B],
    ) -> tuple[dict[str, CameraDetections], A, B]:
        """Return what the cameras see, by name, and what `a` and `b` give; a corrupt image is one of the `faults`."""
        return self._branches.run(
            clock,
            lambda clock: self._cameras.view(frame, clock, faults),
            lambda clock: a(frame, clock),
            lambda clock: b(frame, clock),
        )
