"""Trial of a pipeline on a few frames of a log, and findings about its frames."""

from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.replay.check.findings import Finding, Severity, finding
from fbench.replay.check.times import quantile
from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, FbenchError, LogError, one_line
from fbench.replay.contracts.plugins import guard
from fbench.replay.contracts.protocols import NeedsSensors, Pipeline
from fbench.replay.data.arrays import Int64
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Message, Tick
from fbench.replay.data.rig import Rig, RigChange
from fbench.replay.data.scores import format_count
from fbench.replay.engine.absence import Absence, Absences, Shortage, find_shortage
from fbench.replay.engine.cleaning import Skipped
from fbench.replay.engine.frame_buffer import FrameBuffer, SyncParams
from fbench.replay.logs.reader import LogReader
from fbench.replay.runs.digest import digest


@dataclass(frozen=True)
class SensorFrames:
    """How one sensor takes part in the frames of a log."""

    sensor: str
    num_messages: int
    num_missing: int
    """Frames without it: because it came after the time-out, too early, with stamps too far away, or was unusable."""
    num_late: int
    num_early: int
    num_off: int
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


class Trial:
    """A pipeline, started on a log's rig, and what became of it."""

    def __init__(self, name: str, pipeline: Pipeline, reader: LogReader, left_out: frozenset[str]) -> None:
        """Start it without some sensors. Raises ConfigError where it is the configuration that is wrong."""
        self._name, self._pipeline = name, pipeline
        self._problems: list[Finding] = []
        self._used: dict[str, bool] = {}  # Whether each sensor made a difference
        self._num_tried, self._is_ready, self.has_started = 0, False, False
        self._info, self._left_out = reader.info, left_out
        self._reserve: tuple[Frame, Rig] | None = None  # A frame that lacks sensors, and what it was measured with
        try:
            self._rig = self._started = rig = reader.rig.without(left_out)
        except LogError:  # what is missing of it is a finding already
            self._problems.append(finding("CHK008", "", f"{name} can't start: the rig is incomplete"))
            return
        try:
            pipeline.start(rig, reader.info)
            self._is_ready = self.has_started = True
        except LogError as error:
            self._problems.append(finding("CHK008", "", f"{name} can't start: {error}"))
        except (ConfigError, *INTERRUPTS):
            raise
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything
            why = str(error) if isinstance(error, FbenchError) else one_line(error)
            self._problems.append(finding("PRD002", "", f"{name} can't start: {why}"))

    def change(self, rig: Rig) -> None:
        """Say what the frames from here on are measured with."""
        self._rig = rig.without(self._left_out)

    def offer(self, frame: Frame) -> None:
        """Try the pipeline on this frame if it is among the first complete ones."""
        if self._is_ready and self._num_tried < _TRIALS:
            if frame.missing:
                self._reserve = self._reserve or (frame, self._rig)
            else:
                self._try(frame, self._rig)

    def finish(self) -> None:
        """Try it on some frame at least."""
        if self._is_ready and not self._num_tried and self._reserve is not None:
            self._try(*self._reserve)

    def _try(self, frame: Frame, rig: Rig) -> None:
        """Step with and without each sensor: one that changes nothing isn't used. It starts anew on another rig."""
        self._num_tried += 1
        try:
            if rig is not self._started:
                self._pipeline.start(rig, self._info)
                self._started = rig
            whole = self._step(frame, is_first=self._num_tried == 1)
            for sensor in frame.messages:
                if not self._used.get(sensor, False):
                    rest = {name: m for name, m in frame.messages.items() if name != sensor}
                    self._used[sensor] = self._step(replace(frame, messages=rest)) != whole
        except INTERRUPTS:
            raise
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything
            first = f"stamp {frame.stamp_ns} ns"
            self._problems.append(finding("PRD002", "", f"{self._name}: {one_line(error)}", 1, first))
            self._used, self._is_ready = {}, False

    def _step(self, frame: Frame, is_first: bool = False) -> str:
        self._pipeline.reset("check")
        output = self._pipeline.step(frame)
        for sensor, why in sorted(output.missing.items()) if is_first else ():
            advice = f"see fbench plugins pipelines {self._name} for what it needs, and give it with --set"
            self._problems.append(finding("CHK009", sensor, f"{self._name} can't use it: {why}", advice=advice))
        return digest([output.detections, output.tracks])

    @property
    def required(self) -> frozenset[str] | None:
        """Sensors that the pipeline can't do without; `None` where it doesn't say, or couldn't start."""
        if not (self._is_ready and isinstance(self._pipeline, NeedsSensors)):
            return None
        with guard(f"{self._name} can't say which sensors it needs"):
            needed = self._pipeline.required_sensors()
            return None if needed is None else frozenset(needed)

    def findings(self, stats: FrameStats | None, sync: SyncParams, short: Collection[str]) -> Iterator[Finding]:
        """What went wrong, and what the pipeline would miss, sensor by sensor; one that couldn't be tried counts. Those
        of which it is known that they come `short` are left out.
        """
        yield from self._problems
        if stats is None:
            return
        for s in stats.sensors:
            if s.sensor in short:
                continue
            never, advice = s.num_missing - s.num_late - s.num_early - s.num_off - s.num_skipped, None
            parts = [f"{s.num_early} too early"] if s.num_early else []
            parts += [f"{s.num_off} with stamps too far away"] if s.num_off else []
            parts += [f"{never} never came"] if never > 0 else []
            parts += [f"{s.num_skipped} unusable"] if s.num_skipped else []
            if s.late_max_ms is not None:
                parts.insert(0, f"{s.num_late} late by {s.late_median_ms:.1f} ms (median) to {s.late_max_ms:.1f} ms")
                wanted = -(-(sync.timeout_ns + round(s.late_max_ms * 1e6)) // 1_000_000)
                advice = f"--timeout-ms {wanted} would wait for all that were late"
            severity: Severity | None = None
            text = f"missing from {s.num_missing} of {format_count(stats.num_frames, 'frame')}: {', '.join(parts)}"
            if not self._used.get(s.sensor, True):
                text, severity, advice = f"{text}; {self._name} doesn't use it", "info", "nothing, for this pipeline"
            if s.num_missing:
                yield finding("CHK009", s.sensor, text, s.num_missing, severity=severity, advice=advice)
            if s.num_unused:
                yield finding(
                    "CHK010",
                    s.sensor,
                    f"{format_count(s.num_unused, 'message')} {'is' if s.num_unused == 1 else 'are'} in no frame",
                    s.num_unused,
                )


class FrameCheck:
    """Puts messages into frames as a replay does, counts, and offers frames to a trial."""

    def __init__(self, expected: Sequence[str], reference: str, params: SyncParams, trial: Trial | None) -> None:
        self._buffer, self._params = FrameBuffer(expected, reference, params), params
        self._expected, self._reference, self._trial = tuple(sorted(expected)), reference, trial
        self._lacking = {name: (array("q"), array("q")) for name in self._expected}  # Index and stamp of frames
        self._skipped = Counter[str]()
        self._stamps, self._numbers = array("q"), array("q")
        self._num_complete = 0

    def change(self, change: RigChange) -> None:
        """End the segment where the rig changes."""
        self._count(self._buffer.break_off(change.reason))
        if self._trial is not None:
            self._trial.change(change.rig)

    def add(self, recorded: Message | Tick, message: Message | Tick, usable: Message | Skipped | None) -> None:
        """Add a message as recorded, restamped, and as a pipeline would get it; instants of boxes lack the latter."""
        self._count(self._buffer.advance(message.log_ns))
        if usable is None or message.sensor == self._reference:
            num = self._buffer.num_frames
            self._count(self._buffer.open_frame(message))
            if self._buffer.num_frames > num:
                self._stamps.append(recorded.stamp_ns)
                self._numbers.append(-1 if recorded.frame_number is None else recorded.frame_number)
        if isinstance(usable, Skipped):
            self._skipped[usable.sensor] += 1
        elif usable is not None:
            self._count(self._buffer.add(usable))

    def flush(self) -> None:
        """Release all frames: the log ends."""
        self._count(self._buffer.flush())
        if self._trial is not None:
            self._trial.finish()

    @property
    def stamps(self) -> tuple[Int64, Int64]:
        """Stamps, as recorded, and numbers (-1: none) of all frames."""
        return np.array(self._stamps, np.int64), np.array(self._numbers, np.int64)

    @cached_property
    def _absences(self) -> dict[str, list[Absence]]:
        """Why frames lack each sensor; those of skipped messages, which came, aren't among them."""
        finder, found = Absences(self._buffer, self._params), dict[str, list[Absence]]()
        for name, (indices, stamps) in self._lacking.items():
            own = [finder.find(name, index, stamp) for index, stamp in zip(indices, stamps, strict=True)]
            never = [absence for absence in own if absence.kind == "never"]
            found[name] = [absence for absence in own if absence.kind != "never"] + never[self._skipped[name] :]
        return found

    @property
    def stats(self) -> FrameStats:
        """What was counted."""
        counts, rows = self._buffer.counts, []
        for name in self._expected:
            absences = self._absences[name]
            kinds = Counter(absence.kind for absence in absences)
            late = np.array([absence.ns for absence in absences if absence.kind == "late"], np.int64)
            median, longest = (None if (ns := quantile(late, q)) is None else ns / 1e6 for q in (0.5, 1.0))
            num = len(self._lacking[name][0])
            row = (name, counts.arrivals[name].num, num, kinds["late"], kinds["early"], kinds["off"])
            rows.append(SensorFrames(*row, num - len(absences), median, longest, counts.unused[name]))
        return FrameStats(len(self._stamps), self._num_complete, tuple(rows), tuple(self._buffer.breaks))

    def shortages(self, sensors: Collection[str]) -> list[Shortage]:
        """Find which of these sensors came, but are in hardly any frame."""
        num, found = len(self._stamps), []
        for name in sorted(set(sensors) & set(self._expected)) if num else ():
            absences, arrivals = self._absences[name], self._buffer.counts.arrivals[name]
            num_skipped = len(self._lacking[name][0]) - len(absences)
            shortage = find_shortage(name, num, absences, num_skipped, arrivals, self._params)
            found += [] if shortage is None or shortage.is_silent else [shortage]
        return found

    def _count(self, frames: Iterator[Frame]) -> None:
        for frame in frames:
            for sensor in frame.missing:
                indices, stamps = self._lacking[sensor]
                indices.append(frame.index)
                stamps.append(frame.stamp_ns)
            self._num_complete += not frame.missing
            if self._trial is not None:
                self._trial.offer(frame)
