"""The boxes that another system wrote into the log, or that lie in a file beside it, frame by frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.alongside import Alongside
from fbench.pipelines.checks import require_between
from fbench.pipelines.poses_alongside import PosesAlongside
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import Boxes, Fault, Frame, LogInfo, Rig, Truth
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.geometry.boxes import moved
from fbench.replay.geometry.transforms import inverse
from fbench.replay.protocols import BoxReader


@dataclass(frozen=True)
class Which:
    """Which results, and how they belong to frames: parameters of pipelines that take them."""

    topic: str = ""
    """Topic with the results; empty: the file that was named beside the log, else the only topic with results."""
    tolerance_ms: float = 50.0
    """A result belongs to the nearest frame whose stamp differs by no more than this."""
    offset_ms: float = 0.0
    """What the results' stamps are ahead of those of their frames."""

    def __post_init__(self) -> None:
        require_between("tolerance_ms", self.tolerance_ms, 0.0)
        require_between("offset_ms", self.offset_ms, -1e6)


@dataclass(frozen=True, eq=False)
class Found:
    """What was recorded for one frame."""

    boxes: Boxes | None
    """In body coordinates, or in images of the rig's cameras; `None` where there is no result."""
    world_T_body: Float64 | None
    """Pose (4, 4) of the body, `None` where unknown."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """What isn't there, and why."""
    faults: tuple[Fault, ...] = ()
    latency_ns: int | None = None
    """From the frame's instant to the recording of its result, `None` where it wasn't recorded by a stack at work."""


class RecordedBoxes:
    """Finds the result of each frame.

    Args:
        pipeline: Who asks, for errors.
        params: Which results, and how they belong to frames.
    """

    def __init__(self, pipeline: str, params: Which) -> None:
        self._pipeline, self._params = pipeline, params
        self._name = params.topic or "results"
        self._log: BoxReader | None = None
        self._alongside: Alongside | None = None
        self._poses: PosesAlongside | None = None
        self.kind: type[Boxes] = Boxes3D

    def use_log(self, log: BoxReader) -> None:
        """Take the log whose results are meant."""
        self._log, self._alongside = log, None

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Find out whether boxes are in 3D or in images; a result that holds both counts in 3D.

        Raises:
            LogError: where there are no results, or nothing can move them to the body.
        """
        self._rig = rig
        if self._log is None:
            raise ConfigError(f"pipeline '{self._pipeline}' reads results from a log, and got none")
        if self._alongside is None:
            self.kind = self._first_kind(self._log, log_info)
            results = self._log.detections(self._params.topic)
            to_ns = 1e6
            tolerance_ns, offset_ns = round(self._params.tolerance_ms * to_ns), round(self._params.offset_ms * to_ns)
            self._alongside = Alongside(results, tolerance_ns, offset_ns)
            self._poses = PosesAlongside(self._log.body_poses(), min(self._log.poses, default=None))

    def enter(self) -> None:
        """Begin a segment."""
        if self._alongside is not None:
            self._alongside.enter()

    def take(self, frame: Frame) -> Found:
        """Return what was recorded for the next frame."""
        if self._alongside is None:
            raise ConfigError(f"pipeline '{self._pipeline}' wasn't started")
        result, num_passed = self._alongside.take(frame)
        world_T_body = None if self._poses is None else self._poses.world_T_body(frame)
        faults = (Fault("PRD003", f"{self._name} before frame {frame.index}"),) * num_passed
        if result is None:
            why = f"no output within {self._params.tolerance_ms:g} ms"
            return Found(None, world_T_body, {self._name: why}, faults)
        boxes, missing = self._placed(result, world_T_body)
        latency_ns = result.log_ns - frame.stamp_ns
        # What has the stamp itself for its time of recording wasn't recorded by a stack at work.
        if boxes is None or result.log_ns <= 0 or result.log_ns == result.stamp_ns:
            return Found(boxes, world_T_body, missing, faults)
        if latency_ns < 0:
            faults = (*faults, Fault("PRD004", f"{self._name}: {-latency_ns / 1e6:.3f} ms"))
            return Found(boxes, world_T_body, missing, faults)
        return Found(boxes, world_T_body, missing, faults, latency_ns)

    def _first_kind(self, log: BoxReader, log_info: LogInfo) -> type[Boxes]:
        """Kind of the first boxes that there are; of results without any box the kind of the first one."""
        empty: type[Boxes] | None = None
        for result in log.detections(self._params.topic):
            if result.in_world and not log.poses:
                raise LogError(
                    f"log '{log_info.name}': the boxes of '{self._name}' are in coordinates of the world, and the log "
                    "has no poses to move them to the body; name a topic with poses (`pose` in [body] of fbench.toml)",
                    "CFG001",
                )
            for boxes in (result.boxes3d, result.boxes2d):
                if boxes is not None and len(boxes):
                    return type(boxes)
                empty = type(boxes) if empty is None and boxes is not None else empty
        if empty is None:
            raise LogError(f"log '{log_info.name}': '{self._name}' holds no result that can be used", "CFG001")
        return empty

    def _placed(self, result: Truth, world_T_body: Float64 | None) -> tuple[Boxes | None, dict[str, str]]:
        """Boxes in body coordinates or in images of the rig's cameras, and what is missing."""
        if self.kind is Boxes2D:
            return self._seen(result.boxes2d)
        if result.boxes3d is None:
            return None, {self._name: "no boxes in 3D, as in other frames"}
        if not result.in_world:
            return result.boxes3d, {}
        if world_T_body is None:
            return None, {self._name: "no pose that moves it from the world to the body"}
        return moved(result.boxes3d, inverse(world_T_body)), {}

    def _seen(self, boxes: Boxes2D | None) -> tuple[Boxes | None, dict[str, str]]:
        if boxes is None:
            return None, {self._name: "no boxes in images, as in other frames"}
        known = np.isin(boxes.camera, sorted(self._rig.cameras))
        others = sorted(set(boxes.camera[~known].tolist()))
        return boxes[known], {f"{self._name} in {camera}": "isn't among the cameras of the run" for camera in others}
