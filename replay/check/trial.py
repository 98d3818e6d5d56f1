"""Trying a pipeline on a few frames of a log: whether it starts, and which sensors it uses."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from fbench.replay.check.finding import Finding, finding
from fbench.replay.check.frames import FrameStats, SensorFrames
from fbench.replay.data import Frame, LogInfo, Rig
from fbench.replay.digest import digest
from fbench.replay.errors import ConfigError, FbenchError, LogError, one_line
from fbench.replay.protocols import Pipeline
from fbench.replay.sync import SyncParams

_TRIALS = 3
"""So many complete frames are tried."""


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
        """Start the pipeline on the log's rig.

        Raises:
            ConfigError: where it is the configuration that is wrong.
        """
        try:
            self.pipeline.start(rig, info)
            self._is_ready = True
        except LogError as error:
            self.problems.append(finding("CHK008", "", f"{self.name} can't start: {error}"))
        except ConfigError:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plug-in may raise anything
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
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plug-in may raise anything
            self.problems.append(
                finding("PRD002", "", f"{self.name}: {one_line(error)}", 1, f"stamp {frame.stamp_ns} ns")
            )
            self._used, self._is_ready = {}, False

    def _outcome(self, frame: Frame, first: bool = False) -> str:
        self.pipeline.reset("check")
        output = self.pipeline.step(frame)
        if first:
            for sensor, why in sorted(output.missing.items()):
                advice = f"see fbench plugins pipelines {self.name} for what it needs, and give it with --set"
                self.problems.append(finding("CHK009", sensor, f"{self.name} can't use it: {why}", advice=advice))
        return digest([output.detections, output.tracks])


def missing_findings(trial: Trial, stats: FrameStats, sync: SyncParams) -> Iterator[Finding]:
    """Say what the pipeline would miss, sensor by sensor."""
    for sensor in stats.sensors:
        if sensor.num_missing:
            yield _missing(trial, sensor, stats.num_frames, sync)
        if sensor.num_unused:
            text = f"{sensor.num_unused} messages are in no frame"
            yield finding("CHK010", sensor.sensor, text, sensor.num_unused)


def _missing(trial: Trial, sensor: SensorFrames, num_frames: int, sync: SyncParams) -> Finding:
    never = sensor.num_missing - sensor.num_late - sensor.num_skipped
    parts = [f"{never} never came"] if never > 0 else []
    parts += [f"{sensor.num_skipped} unusable"] if sensor.num_skipped else []
    advice = None
    if sensor.late_max_ms is not None:
        parts.insert(0, f"{sensor.num_late} late by {sensor.late_median_ms:.1f} ms (median) to "
                        f"{sensor.late_max_ms:.1f} ms")  # fmt: skip
        wanted = -(-(sync.timeout_ns + round(sensor.late_max_ms * 1e6)) // 1_000_000)
        advice = f"--timeout-ms {wanted} would wait for all that were late"
    text = f"missing from {sensor.num_missing} of {num_frames} frames: {', '.join(parts)}"
    if not trial.uses(sensor.sensor):
        return finding("CHK009", sensor.sensor, f"{text}; {trial.name} doesn't use it", sensor.num_missing,
                       severity="info", advice="nothing, for this pipeline")  # fmt: skip
    return finding("CHK009", sensor.sensor, text, sensor.num_missing, advice=advice)
