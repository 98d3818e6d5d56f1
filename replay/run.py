"""The one loop: log -> frames -> pipeline -> run folder."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fbench.replay.boxes import Boxes2D
from fbench.replay.clean import clean
from fbench.replay.clock import Clock, VirtualClock
from fbench.replay.data import Boxes, Frame, Message, Output, Truth
from fbench.replay.digest import START, Digest, digest, link
from fbench.replay.errors import LogError, RunError
from fbench.replay.faults import FaultLog
from fbench.replay.host import package_versions
from fbench.replay.manifest import FrameEntry, LogEntry, Manifest, rig_entries
from fbench.replay.media import MediaKeeper
from fbench.replay.protocols import Pipeline, Reader
from fbench.replay.store import FrameRecord, RunWriter
from fbench.replay.sync import NOT_THERE, FrameBuffer, SyncCounts, SyncParams, choose_reference

MAX_FAILURES_IN_A_ROW = 10
"""A pipeline that fails on so many frames in a row is given up."""
TRUTH_TOLERANCE_NS = 10_000_000
"""Truth without a frame number belongs to the nearest frame not farther away than this."""


@dataclass(frozen=True)
class Plan:
    """What to run and how."""

    pipeline: Pipeline
    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    sync: SyncParams = field(default_factory=SyncParams)
    clock: Clock = field(default_factory=VirtualClock)
    tolerant: bool = False
    """Data loss is counted, but the run is complete all the same."""
    num_media: int = 8
    """So many frames at least keep images and points for reports, where the log has as many."""
    progress: Callable[[int], None] = lambda num_frames: None


def replay(reader: Reader, plan: Plan, folder: Path, faults: FaultLog, overwrite: bool = False) -> Path:
    """Replay a log into a pipeline and write the run folder; returns its path.

    Raises:
        ConfigError: where the folder exists or can't be written.
        LogError: where the log can't be used by this pipeline.
        RunError: where the pipeline keeps failing.
    """
    with RunWriter(folder, overwrite) as writer:
        loop = _Loop(reader, plan, faults, writer)
        plan.pipeline.start(reader.rig, reader.info)
        for frame in loop.frames(reader):
            loop.step(frame)
            plan.progress(frame.index + 1)
        loop.require_results()
        loop.finish(reader)
        return writer.finish(loop.manifest())


class _Loop:
    """The state of one replay."""

    def __init__(self, reader: Reader, plan: Plan, faults: FaultLog, writer: RunWriter) -> None:
        self._rig, self._info = reader.rig, reader.info
        self._plan, self._faults, self._writer = plan, faults, writer
        self.reference = choose_reference(self._rig, self._info, plan.sync)
        expected = (*self._rig.sensors("camera", "lidar", "radar"), *reader.poses)
        self._buffer = FrameBuffer(expected, self.reference, plan.sync)
        self._media = MediaKeeper(self._rig, plan.num_media)
        self._log_digest = Digest()
        self._chain, self._segment, self._failures = START, 0, 0

    def frames(self, reader: Reader) -> Iterator[Frame]:
        """Read the log and yield its frames."""
        for message in reader.messages():
            self._log_digest.add(message)
            yield from self._buffer.advance(message.log_ns)
            if message.sensor == self.reference:
                yield from self._opened(message)
            self._plan.clock.wait_until(message.log_ns)
            usable = clean(message, self._faults)
            if usable is not None:
                yield from self._buffer.add(usable)
        yield from self._buffer.flush()

    def _opened(self, message: Message) -> Iterator[Frame]:
        num_breaks = len(self._buffer.breaks)
        yield from self._buffer.open_frame(message)
        for why in self._buffer.breaks[num_breaks:]:
            self._faults.add("TIM007" if why.startswith("gap") else "TIM005", why)
            self._plan.clock.restart()

    def step(self, frame: Frame) -> None:
        """Run the pipeline on one frame and record what it gives."""
        if frame.segment != self._segment:
            self._segment = frame.segment
            self._plan.pipeline.reset(self._buffer.breaks[frame.segment - 1])
        start = time.perf_counter_ns()
        output, failed = self._guarded(frame)
        total_ns = time.perf_counter_ns() - start
        self._record(frame, output, failed, total_ns)
        self._media.offer(frame)

    def _guarded(self, frame: Frame) -> tuple[Output | None, str | None]:
        """Step the pipeline; a failure is a fault of the frame, until there are too many in a row."""
        try:
            output = self._plan.pipeline.step(frame)
            if not isinstance(output, Output):
                raise TypeError(f"step() gave {type(output).__name__}, not Output")
        except Exception as error:  # a plug-in may raise anything, and the other frames still count
            self._failures += 1
            why = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no message'}"
            if self._failures >= MAX_FAILURES_IN_A_ROW:
                raise RunError(
                    f"pipeline '{self._plan.name}' failed on {self._failures} frames in a row: {why}"
                ) from error
            self._faults.add("PRD002", f"frame {frame.index}: {why}")
            return None, why
        self._failures = 0
        for fault in output.faults:
            self._faults.add(fault.code, f"frame {frame.index}: {fault.where}")
        return output, None

    def _record(self, frame: Frame, output: Output | None, failed: str | None, total_ns: int) -> None:
        results = None if output is None else (output.detections, output.tracks)
        missing = {**frame.missing, **({} if output is None else output.missing)}
        content = [frame.index, frame.stamp_ns, frame.segment, missing, failed, results]
        frame_digest = digest(content)
        self._chain = link(self._chain, frame_digest)
        if results is not None:
            self._count_invalid(frame, *results)
            self._writer.add_boxes("detections", frame.index, results[0])
            self._writer.add_boxes("tracks", frame.index, results[1])
        number, stamp = frame.frame_number, frame.stamp_ns
        record = FrameRecord(frame.index, stamp, frame.segment, number, missing, frame_digest, self._chain, failed)
        stages = {} if output is None else output.stage_ns
        self._writer.add_frame(record, {**stages, "total": total_ns})

    def _count_invalid(self, frame: Frame, detections: Boxes, tracks: Boxes) -> None:
        for what, boxes in (("detections", detections), ("tracks", tracks)):
            outline = boxes.xyxy_px if isinstance(boxes, Boxes2D) else np.hstack([boxes.center_m, boxes.size_lwh_m])
            bad = ~np.isfinite(outline).all(axis=1)
            if boxes.score is not None:
                bad |= ~np.isfinite(boxes.score)
            if bad.any():
                self._faults.add("PRD001", f"frame {frame.index}: {what}", int(bad.sum()))

    def require_results(self) -> None:
        """Refuse to write a run of nothing.

        Raises:
            LogError: without a single frame.
            RunError: where the pipeline failed on every frame.
        """
        records = self._writer.records
        if not records:
            raise LogError(f"log '{self._info.name}' gives no frames: no message of '{self.reference}'")
        if all(record.failed is not None for record in records):
            raise RunError(f"pipeline '{self._plan.name}' failed on all {len(records)} frames: {records[0].failed}")

    def finish(self, reader: Reader) -> None:
        """Attach truth, explain what was missing, and write what isn't a table."""
        for index, truth in _matched(self._digested(reader.truths()), self._writer):
            self._writer.label_frame(index, truth)
        counts = self._buffer.counts
        if counts.disordered:
            self._faults.add("TIM001", self.reference, counts.disordered)
        self._writer.explain_missing(lambda record: _explained(record, counts))
        self._writer.write_media(self._media.frames)
        faults = {"lost": self._faults.lost, "unused_messages": counts.unused, "rows": self._faults.rows()}
        self._writer.write_json("faults.json", faults)

    def _digested(self, truths: Iterator[Truth]) -> Iterator[Truth]:
        for truth in truths:
            self._log_digest.add(truth)
            yield truth

    def manifest(self) -> Manifest:
        """Say what ran."""
        mounts, cameras = rig_entries(self._rig)
        info, sync = self._info, self._plan.sync
        return Manifest(
            complete=self._plan.tolerant or self._faults.lost == 0,
            log=LogEntry(
                name=info.name,
                log_id=info.log_id,
                digest=self._log_digest.hex(),
                metadata=dict(sorted(info.metadata.items())),
            ),
            pipeline=self._plan.name,
            parameters=dict(self._plan.parameters),
            frames=FrameEntry(
                reference=self.reference,
                timeout_ns=sync.timeout_ns,
                tolerance_ns=sync.tolerance_ns,
                max_gap_ns=sync.max_gap_ns,
                max_jump_ns=sync.max_jump_ns,
            ),
            mounts=mounts,
            cameras=cameras,
            num_frames=len(self._writer.records),
            num_segments=self._segment + 1,
            digest=self._chain,
            versions=package_versions(),
        )


def _explained(record: FrameRecord, counts: SyncCounts) -> FrameRecord:
    """Say of each sensor that wasn't there in time whether it came too late or never."""

    def why(sensor: str, reason: str) -> str:
        late = counts.late_ms.get((record.index, sensor))
        if late is not None:
            return f"late by {late:.1f} ms"
        return "never came" if reason.startswith(NOT_THERE) else reason

    return replace(record, missing={sensor: why(sensor, reason) for sensor, reason in record.missing.items()})


def _matched(truths: Iterator[Truth], writer: RunWriter) -> Iterator[tuple[int, Truth]]:
    """Find the frame of each truth: by frame number where both have one, else by nearest stamp; one truth a frame."""
    records = writer.records
    by_number = {r.frame_number: r.index for r in reversed(records) if r.frame_number is not None}
    stamps = np.array([r.stamp_ns for r in records], np.int64)
    order = np.argsort(stamps, kind="stable")
    taken: dict[int, bool] = {}
    for truth in truths:
        index = (
            by_number.get(truth.frame_number)
            if truth.frame_number is not None
            else _nearest(stamps, order, truth.stamp_ns)
        )
        if index is not None and not taken.setdefault(index, False):
            taken[index] = True
            yield index, truth


def _nearest(stamps: Any, order: Any, stamp_ns: int) -> int | None:
    at = int(np.searchsorted(stamps[order], stamp_ns))
    near = [int(i) for i in order[max(0, at - 1) : at + 1]]
    best = min(near, key=lambda i: (abs(int(stamps[i]) - stamp_ns), i), default=None)
    return best if best is not None and abs(int(stamps[best]) - stamp_ns) <= TRUTH_TOLERANCE_NS else None
