"""Detecting on every N-th frame only, with tracks predicted in between."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from fbench.pipelines.checks import require_between
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Boxes, Fault, Output

NOTHING: Mapping[str, str] = MappingProxyType({})
"""No sensor is missing."""


class Rhythm:
    """Says in which frames of a segment is detected: the first, and every so many-th after it.

    It counts frames, whatever sensors they hold, so that which ones are due is a property of the log's frames alone.

    Raises:
        ConfigError: where `every` is less than 1.
    """

    def __init__(self, every: int) -> None:
        require_between("detect_every", every, 1)
        self._every, self._num = every, 0

    def reset(self) -> None:
        """Begin a segment, whose first frame is due."""
        self._num = 0

    def due(self) -> bool:
        """Count a frame, and tell whether detection runs in it; to be asked once a frame."""
        is_due = self._num % self._every == 0
        self._num += 1
        return is_due


def predicted(
    predict: Callable[[], Boxes],
    missing: Mapping[str, str] = NOTHING,
    *,
    clock: StageClock | None = None,
    faults: tuple[Fault, ...] = (),
) -> Output:
    """Output of a frame that isn't due: the predicted tracks stand for its detections; nothing is decoded.

    Args:
        predict: Gives the tracks at the frame's instant, marked as predicted; timed as `track`.
        missing: Sensors that the pipeline can't use in any frame, with the reason.
        clock: With the stages that ran before.
        faults: Met before.
    """
    clock = clock or StageClock()
    with clock.stage("track"):
        tracks = predict()
    return Output(tracks, tracks, clock.stage_ns, faults, missing)
