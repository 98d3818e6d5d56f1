"""Trial of a pipeline on a few frames of a log, and findings about its frames."""

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.replay.check.findings import Finding, Severity, finding
from fbench.replay.check.times import quantile
from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, FbenchError, LogError, one_line
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.data.arrays import Int64
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Message, Tick
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.engine.cleaning import Skipped
from fbench.replay.engine.frame_buffer import FrameBuffer, SyncParams
from fbench.replay.runs.digest import digest


@dataclass(frozen=True)
class SensorFrames:
    """How one sensor takes part in the frames of a log."""

    sensor: str
    num_missing: int
    """Frames without it; `num_late` of them because it came after the time-out, `num_skipped` since it was unusable."""
    num_late: int
    num_skipped: int
    late_median_ms: float | None
    late_max_ms: float | None
    num_unused: int  # Messages that are in no frame


@dataclass(frozen=True)
class FrameStats:
    """All frames of a log."""

    num_frames: int
    num_complete: int
    sensors: tuple[SensorFrames, ...]
    breaks: tuple[str, ...]  # Where a new segment begins, and why


_TRIALS = 3  # So many complete frames are tried


@dataclass
class Trial:
    """A pipeline and what became of it."""

    name: str
    pipeline: Pipeline
    problems: list[Finding] = field(default_factory=list)
    _used: dict[str, bool] = field(default_factory=dict)
    _num_tried: int = 0
    _reserve: Frame | None = None
    _is_ready: bool = False

    def start(self, rig: Rig, info: LogInfo) -> None:
        """Start the pipeline on the log's rig. Raises ConfigError where it is the configuration that is wrong."""
        try:
            self.pipeline.start(rig, info)
            self._is_ready = True
        except LogError as error:
            self.problems.append(finding("CHK008", "", f"{self.name} can't start: {error}"))
        except ConfigError:
            raise
        except INTERRUPTS:
            raise
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything
            why = str(error) if isinstance(error, FbenchError) else one_line(error)
            self.problems.append(finding("PRD002", "", f"{self.name} can't start: {why}"))

    def offer(self, frame: Frame) -> None:
        """Try the pipeline on this frame if it is among the first complete ones."""
        if self._is_ready and self._num_tried < _TRIALS:
            if frame.missing:
                self._reserve = self._reserve or frame
            else:
                self._try(frame)

    def finish(self) -> None:
        """Try it on some frame at least."""
        if self._is_ready and not self._num_tried and self._reserve is not None:
            self._try(self._reserve)
        self._reserve = None

    def uses(self, sensor: str) -> bool:
        """Tell whether the sensor made a difference; assumed where that couldn't be tried."""
        return self._used.get(sensor, True)

    def _try(self, frame: Frame) -> None:
        """Step with and without each sensor: one that changes nothing isn't used."""
        self._num_tried += 1
        try:
            whole = self._outcome(frame, first=self._num_tried == 1)
            for sensor in frame.messages:
                if not self._used.get(sensor, False):
                    rest = {name: m for name, m in frame.messages.items() if name != sensor}
                    self._used[sensor] = self._outcome(replace(frame, messages=rest)) != whole
        except INTERRUPTS:
            raise
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything
            first = f"stamp {frame.stamp_ns} ns"
            self.problems.append(finding("PRD002", "", f"{self.name}: {one_line(error)}", 1, first))
            self._used, self._is_ready = {}, False

    def _outcome(self, frame: Frame, first: bool = False) -> str:
        self.pipeline.reset("check")
        output = self.pipeline.step(frame)
        if first:
            for sensor, why in sorted(output.missing.items()):
                advice = f"see fbench plugins pipelines {self.name} for what it needs, and give it with --set"
                self.problems.append(finding("CHK009", sensor, f"{self.name} can't use it: {why}", advice=advice))
        return digest([output.detections, output.tracks])


class FrameCheck:
    """Puts messages into frames as a replay does, counts, and offers frames to a trial."""

    def __init__(self, expected: Sequence[str], reference: str, params: SyncParams, trial: Trial | None) -> None:
        self._buffer = FrameBuffer(expected, reference, params)
        self._expected, self._reference, self._trial = tuple(sorted(expected)), reference, trial
        self._missing: Counter[str] = Counter()
        self._skipped: Counter[str] = Counter()
        self._stamps, self._numbers = array("q"), array("q")
        self._num_complete = 0

    def change(self, change: RigChange) -> None:
        """End the segment where the rig changes."""
        self._count(self._buffer.break_off(change.reason))

    def add(self, recorded: Message, message: Message, usable: Message | Skipped) -> None:
        """Add one message, as recorded, with the stamp that counts, and as a pipeline would get it."""
        self._count(self._buffer.advance(message.log_ns))
        if message.sensor == self._reference:
            self._open(recorded, message)
        if isinstance(usable, Skipped):
            self._skipped[usable.sensor] += 1
        else:
            self._count(self._buffer.add(usable))

    def tick(self, tick: Tick) -> None:
        """Add an instant that boxes give."""
        self._count(self._buffer.advance(tick.log_ns))
        self._open(tick, tick)

    def flush(self) -> None:
        """Release all frames: the log ends."""
        self._count(self._buffer.flush())

    @property
    def stamps(self) -> tuple[Int64, Int64]:
        """Stamps, as recorded, and numbers (-1: none) of all frames."""
        return np.array(self._stamps, np.int64), np.array(self._numbers, np.int64)

    @property
    def stats(self) -> FrameStats:
        """What was counted."""
        counts = self._buffer.counts
        late: dict[str, list[int]] = {name: [] for name in self._expected}
        for (_, sensor), ms in counts.late_ms.items():
            late[sensor].append(round(ms * 1e6))
        rows = []
        for name in self._expected:
            median, longest = (quantile(np.array(late[name], np.int64), share) for share in (0.5, 1.0))
            rows.append(SensorFrames(
                name, self._missing[name], len(late[name]), min(self._skipped[name], self._missing[name]),
                None if median is None else median / 1e6, None if longest is None else longest / 1e6,
                counts.unused[name],
            ))  # fmt: skip
        return FrameStats(len(self._stamps), self._num_complete, tuple(rows), tuple(self._buffer.breaks))

    def _open(self, recorded: Message | Tick, message: Message | Tick) -> None:
        num = self._buffer.num_frames
        self._count(self._buffer.open_frame(message))
        if self._buffer.num_frames > num:
            self._stamps.append(recorded.stamp_ns)
            self._numbers.append(-1 if recorded.frame_number is None else recorded.frame_number)

    def _count(self, frames: Iterator[Frame]) -> None:
        for frame in frames:
            self._missing.update(list(frame.missing))
            self._num_complete += not frame.missing
            if self._trial is not None:
                self._trial.offer(frame)


def missing_findings(trial: Trial, stats: FrameStats, sync: SyncParams) -> Iterator[Finding]:
    """Say what the pipeline would miss, sensor by sensor."""
    for s in stats.sensors:
        never, advice = s.num_missing - s.num_late - s.num_skipped, None
        parts = [f"{never} never came"] if never > 0 else []
        parts += [f"{s.num_skipped} unusable"] if s.num_skipped else []
        if s.late_max_ms is not None:
            parts.insert(0, f"{s.num_late} late by {s.late_median_ms:.1f} ms (median) to {s.late_max_ms:.1f} ms")
            wanted = -(-(sync.timeout_ns + round(s.late_max_ms * 1e6)) // 1_000_000)
            advice = f"--timeout-ms {wanted} would wait for all that were late"
        severity: Severity | None = None
        text = f"missing from {s.num_missing} of {stats.num_frames} frames: {', '.join(parts)}"
        if not trial.uses(s.sensor):
            text, severity, advice = f"{text}; {trial.name} doesn't use it", "info", "nothing, for this pipeline"
        if s.num_missing:
            yield finding("CHK009", s.sensor, text, s.num_missing, severity=severity, advice=advice)
        if s.num_unused:
            yield finding("CHK010", s.sensor, f"{s.num_unused} messages are in no frame", s.num_unused)
