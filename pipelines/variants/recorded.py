"""recorded: the results that another system wrote into the log, or that lie in a file beside it."""

from dataclasses import dataclass
from typing import ClassVar

from fbench.pipelines.sensors.recorded import RecordedBoxes, Which
from fbench.replay.contracts.protocols import BoxReader
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

STAGE = "recorded"
"""Stands for all that the other system did."""


@dataclass(frozen=True)
class RecordedParams(Which):
    """Parameters of `recorded`."""


class Recorded:
    """Passes on what was recorded. Latency is the time from a frame's instant to the recording of its result."""

    argument: ClassVar[str] = "topic"

    def __init__(self, params: RecordedParams = RecordedParams()) -> None:
        self._recorded = RecordedBoxes("recorded", params)

    def use_log(self, log: BoxReader) -> None:
        """Take the log whose results are meant."""
        self._recorded.use_log(log)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Find out whether boxes are in 3D or in images; a result that holds both counts in 3D.

        Raises:
            LogError: where there are no results, or nothing can move them to the body.
        """
        self._recorded.start(rig, log_info)

    def reset(self, reason: str) -> None:
        """Begin a segment."""
        self._recorded.enter()

    def step(self, frame: Frame) -> Output:
        """Pass on the frame's result; boxes with ids are its tracks."""
        found = self._recorded.take(frame)
        boxes = self._recorded.kind.empty() if found.boxes is None else found.boxes
        stage_ns = {} if found.latency_ns is None else {STAGE: found.latency_ns}
        return Output(boxes, boxes, stage_ns, found.faults, found.missing, clock="log")
