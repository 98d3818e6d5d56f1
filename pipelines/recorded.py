"""recorded: the results that another system wrote into the log, or that lie in a file beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fbench.pipelines.alongside import Alongside
from fbench.pipelines.checks import require_between
from fbench.pipelines.poses_alongside import PosesAlongside
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import Boxes, Fault, Frame, LogInfo, Output, Rig, Truth
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.geometry.boxes import moved
from fbench.replay.geometry.transforms import inverse
from fbench.replay.protocols import BoxReader

STAGE = "recorded"
"""Stands for all that the other system did."""


@dataclass(frozen=True)
class RecordedParams:
    """Parameters of `recorded`."""

    topic: str = ""
    """Topic with the results; empty: the file that was named beside the log, else the only topic with results."""
    tolerance_ms: float = 50.0
    """A result belongs to the nearest frame whose stamp differs by no more than this."""
    offset_ms: float = 0.0
    """What the results' stamps are ahead of those of their frames."""

    def __post_init__(self) -> None:
        require_between("tolerance_ms", self.tolerance_ms, 0.0)
        require_between("offset_ms", self.offset_ms, -1e6)


class Recorded:
    """Passes on what was recorded. Latency is the time from a frame's instant to the recording of its result."""

    argument: ClassVar[str] = "topic"

    def __init__(self, params: RecordedParams = RecordedParams()) -> None:
        self._params = params
        self._name = params.topic or "results"
        self._log: BoxReader | None = None
        self._alongside: Alongside | None = None
        self._poses: PosesAlongside | None = None
        self._kind: type[Boxes] = Boxes3D

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
            raise ConfigError("pipeline 'recorded' reads results from a log, and got none")
        if self._alongside is None:
            self._kind = self._first_kind(self._log, log_info)
            results = self._log.detections(self._params.topic)
            to_ns = 1e6
            tolerance_ns, offset_ns = round(self._params.tolerance_ms * to_ns), round(self._params.offset_ms * to_ns)
            self._alongside = Alongside(results, tolerance_ns, offset_ns)
            self._poses = PosesAlongside(self._log.body_poses(), min(self._log.poses, default=None))

    def reset(self, reason: str) -> None:
        """Begin a segment."""
        if self._alongside is not None:
            self._alongside.enter()

    def step(self, frame: Frame) -> Output:
        """Pass on the frame's result; boxes with ids are its tracks."""
        if self._alongside is None:
            raise ConfigError("pipeline 'recorded' wasn't started")
        result, num_passed = self._alongside.take(frame)
        world_T_body = None if self._poses is None else self._poses.world_T_body(frame)
        faults = [Fault("PRD003", f"{self._name} before frame {frame.index}")] * num_passed
        if result is None:
            return self._output(None, {self._name: f"no output within {self._params.tolerance_ms:g} ms"}, faults)
        boxes, missing = self._placed(result, world_T_body)
        if boxes is None:
            return self._output(None, missing, faults)
        latency_ns = result.log_ns - frame.stamp_ns
        # What has the stamp itself for its time of recording wasn't recorded by a stack at work.
        if result.log_ns <= 0 or result.log_ns == result.stamp_ns:
            return self._output(boxes, missing, faults)
        if latency_ns < 0:
            faults.append(Fault("PRD004", f"{self._name}: {-latency_ns / 1e6:.3f} ms"))
            return self._output(boxes, missing, faults)
        return self._output(boxes, missing, faults, latency_ns)

    def _output(
        self,
        boxes: Boxes | None,
        missing: Mapping[str, str],
        faults: list[Fault],
        latency_ns: int | None = None,
    ) -> Output:
        found = self._kind.empty() if boxes is None else boxes
        stage_ns = {} if latency_ns is None else {STAGE: latency_ns}
        return Output(found, found, stage_ns, tuple(faults), missing, clock="log")

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
        if self._kind is Boxes2D:
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
