"""The one loop: log -> frames -> pipeline -> run folder."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from fbench.replay.conditions.disturb import DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import guard
from fbench.replay.contracts.protocols import GivesWarnings, NeedsSensors, Reader, TellsIdentity, Tracks, UsesSensors
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.boxes import Boxes, finite
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import format_count
from fbench.replay.engine.absence import LEAST_FRAMES
from fbench.replay.engine.cleaning import check_faults
from fbench.replay.engine.frames import FrameStream
from fbench.replay.engine.latency_profile import FrameContent
from fbench.replay.engine.missing import MissingSensors
from fbench.replay.engine.overlap import Overlap
from fbench.replay.engine.plan import Plan
from fbench.replay.engine.service_queue import LatencyModel, Service, ServiceQueue
from fbench.replay.engine.shared import SharedReader
from fbench.replay.engine.stepping import Step, Stepper
from fbench.replay.engine.warm_up import WarmUp
from fbench.replay.runs import manifest
from fbench.replay.runs.digest import START, digest, link
from fbench.replay.runs.folder import FrameRecord, RunWriter
from fbench.replay.runs.media import MediaKeeper
from fbench.replay.runs.redaction import redact_manifest, redact_record, redact_rows
from fbench.replay.runs.secrets import clean_mapping
from fbench.replay.runs.timings import OUTPUT, WAIT, WHOLE


def replay(
    reader: Reader,
    plan: Plan,
    folder: Path,
    faults: FaultLog,
    overwrite: bool = False,
    complete: Callable[[Path], None] = lambda folder: None,
) -> Path:
    """Replay a log into a pipeline as planned and write the run folder; returns its path.

    `faults` counts those of the reader too; `overwrite` replaces a run that is there; `complete` adds to the folder,
    scores for instance, before it gets its name. Raises ConfigError where the folder exists or can't be written,
    LogError where the log can't be used by this pipeline, RunError where the pipeline keeps failing.
    """
    effects = reader.effects if isinstance(reader, SharedReader) else Effects()
    if isinstance(reader, SharedReader):
        reader.is_used = _find_used(plan, reader.rig)
    elif plan.disturbance:
        reader = DisturbedReader(reader, plan.disturbance, effects, _find_used(plan, reader.rig))
    with RunWriter(folder, overwrite) as writer, closing(WarmUp()) as warm_up:
        loop = _Loop(reader, plan, faults, writer, warm_up, effects)
        loop.stepper.start()
        for num_frames, _ in enumerate(loop.steps(reader), 1):
            plan.progress(num_frames)
        loop.require_results()
        loop.finish(reader)
        return writer.finish(loop.manifest(), complete)


def _find_used(plan: Plan, rig: Rig) -> Callable[[str], bool]:
    """Return what tells whether anybody uses messages of a sensor: the pipeline, once it has started, or who looks at
    the images and points that are kept.
    """
    names, pipeline = rig.sensors("camera", "lidar", "radar"), plan.pipeline
    left_out = {*names} - {*choose_sensors(names, plan.sensors)}
    if (plan.num_media and not plan.redact) or not isinstance(pipeline, UsesSensors):
        return lambda sensor: sensor not in left_out

    def is_used(sensor: str) -> bool:
        with guard(f"pipeline '{plan.name}' can't say which sensors it uses"):
            return sensor in pipeline.used_sensors()

    return is_used


class _Loop:
    """The state of one replay."""

    def __init__(
        self, reader: Reader, plan: Plan, faults: FaultLog, writer: RunWriter, warm_up: WarmUp, effects: Effects
    ) -> None:
        self._plan, self._faults, self._writer = plan, faults, writer
        self._effects = effects
        params = (plan.sync, plan.stamps, plan.excerpt, plan.clock, faults, plan.sensors, plan.max_between_ns)
        self.stream = FrameStream(reader, *params)
        self._info = reader.info
        given = (plan, self.stream.rig, self._info, faults, warm_up)
        self.stepper = Stepper(*given, self._disturb, lambda segment: self.stream.buffer.breaks[segment - 1])
        self._media = MediaKeeper(0 if plan.redact else plan.num_media)
        self._chain = START
        self._num_detections = self._num_tracks = self._num_dropped = 0
        self._says_tracks = False  # Whether the pipeline ever said what it tracks, if only that it is nothing
        self._missing = MissingSensors(self.stream)

    def _disturb(self, true: Rig) -> Rig:
        """Return the rig that the pipeline is given, maybe disturbed; results are judged by the true one."""
        rig = self._plan.disturbance.rig(true, self._info.log_id)
        self._effects.add_rig(true, rig)
        return rig

    def steps(self, reader: Reader) -> Iterator[None]:
        """Run the pipeline on all frames that it gets and record what it gives, a frame a step."""
        frames = ((frame, self.stream.rig) for frame in self.stream.frames(reader))
        if self._plan.overlap is not None:
            yield from self._overlap(self._plan.overlap, frames)
            return
        if self._plan.latency is None:
            for frame, rig in frames:
                self._record(frame, rig, self.stepper.step(frame, rig))
                yield
            return
        queue = ServiceQueue(self._plan.latency.policy, self._serve)
        arrivals = ((item, self.stream.buffer.ready_ns[item[0].index]) for item in frames)
        for (frame, rig), service in queue.run(arrivals):
            if service is None:
                self._num_dropped += 1
                self.stepper.skip(frame)
            self._record(frame, rig, Step() if service is None else service.result, service)
            yield

    def _overlap(self, overlap: Overlap, frames: Iterator[tuple[Frame, Rig]]) -> Iterator[None]:
        """Do the same, where processes observe frames before their turn comes."""
        used, info, disturbance = None, self._info, self._plan.disturbance
        if isinstance(self._plan.pipeline, UsesSensors):
            with guard(f"pipeline '{self._plan.name}' can't say which sensors it uses"):
                used = frozenset(self._plan.pipeline.used_sensors())
        for frame, rig, observed in overlap.run(frames, info, lambda rig: disturbance.rig(rig, info.log_id), used):
            self._record(frame, rig, self.stepper.step(frame, rig, observed))
            yield

    def _serve(self, item: tuple[Frame, Rig]) -> tuple[Step, int]:
        """Run the pipeline on a frame, say how much log time passes. Raises ConfigError where nobody measured it."""
        model, step = self._plan.latency or LatencyModel(), self.stepper.step(*item)
        output = step.output
        if model.fixed_ns is None and output is not None and output.clock != "host":
            how = "measured" if model.profile is None else "profile"
            raise ConfigError(
                f"--latency {how}: the results of pipeline '{self._plan.name}' were computed elsewhere, so nothing is "
                "measured here; give a time, such as --latency fixed:80ms"
            )
        if model.profile is None:
            return step, model.service_ns(step.total_ns)
        frame, num_boxes = item[0], 0 if output is None else len(output.detections)
        content = FrameContent(frame.num_points, num_boxes, frame.num_pixels)
        key = (model.seed, self._info.log_id, frame.index)
        return step, model.service_ns(model.profile.draw_ns(*key, content, None if output is None else output.stage_ns))

    def _record(self, frame: Frame, rig: Rig, step: Step, service: Service[Step] | None = None) -> None:
        start, output, failed = time.perf_counter_ns(), step.output, step.failed
        stamp, segment = frame.stamp_ns, frame.segment
        results = None if output is None else self._note_tracks(output)
        self._missing.note(frame, len(self._writer.records))
        missing = {**frame.missing, **({} if output is None else clean_mapping(output.missing))}
        frame_digest = digest([frame.index, stamp, segment, missing, failed, results])
        self._chain = link(self._chain, frame_digest)
        for name, boxes in zip(("detections", "tracks"), results or (), strict=False):
            sane, scored = finite(boxes)
            if num := int(np.count_nonzero(~(sane & scored))):
                self._faults.add("PRD001", f"frame {frame.index}: {name}", num)
            self._writer.add_boxes(name, frame.index, boxes)
        number, chain = frame.frame_number, self._chain
        parts = {} if output is None else output.digests
        facts = (frame.index, stamp, segment, number, missing, frame_digest, chain, failed)
        points, pixels = frame.num_points, frame.num_pixels
        record = FrameRecord(*facts, stages=parts, num_points=points, num_pixels=pixels)
        if self._plan.latency is not None:
            start_ns, done_ns = (None, None) if service is None else (service.start_ns, service.done_ns)
            ready_ns = self.stream.buffer.ready_ns[frame.index]
            record = replace(record, ready_ns=ready_ns, start_ns=start_ns, done_ns=done_ns)
        stages = {} if output is None else output.stage_ns
        if record.is_dropped:
            self._writer.add_frame(record, {})
        elif output is None or output.clock == "host":
            cpu_ns = {
                **({} if output is None else output.cpu_ns),
                **({} if step.cpu_ns is None else {WHOLE: step.cpu_ns}),
            }
            self._writer.add_frame(record, {**stages, WHOLE: step.total_ns}, "host", step.compiled, cpu_ns)
        else:
            self._writer.add_frame(record, {**stages, WHOLE: sum(stages.values())} if stages else {}, "log")
        waited_ns = self.stream.buffer.ready_ns[frame.index] - self.stream.buffer.first_ns[frame.index]
        self._writer.timings.add(frame.index, {WAIT: waited_ns}, "log", outside=True)
        self._writer.timings.add(frame.index, {OUTPUT: time.perf_counter_ns() - start}, outside=True)
        self._media.offer(rig, frame)

    def _note_tracks(self, output: Output) -> tuple[Boxes, Boxes]:
        """Return detections and tracks, and remember whether there ever were any."""
        detections, tracks = output.detections, output.tracks
        self._num_detections += len(detections)
        if tracks is None:
            return detections, type(detections).empty()
        self._num_tracks, self._says_tracks = self._num_tracks + len(tracks), True
        return detections, tracks

    def _has_tracks(self) -> bool:
        """Tell whether the pipeline tracks. Where it doesn't say so itself, empty tracks beside detections mean that it
        only detects: many programs fill in what they don't know so.
        """
        if self._num_tracks:
            return True
        with guard(f"pipeline '{self._plan.name}' can't say whether it tracks"):
            if isinstance(self._plan.pipeline, Tracks) and (says := self._plan.pipeline.is_tracker) is not None:
                return bool(says)
        return self._says_tracks and not self._num_detections

    def require_results(self) -> None:
        """Refuse to write nothing. Raises LogError without a frame, RunError where all frames failed."""
        records = [record for record in self._writer.records if not record.is_dropped]
        self.stream.require_frames(self._info.name)
        if all(record.failed is not None for record in records):
            frames = format_count(len(records), "frame")
            raise RunError(f"pipeline '{self._plan.name}' failed on all {frames}: {records[0].failed}")

    def finish(self, reader: Reader) -> None:
        """Attach truth, explain what was missing, and write what isn't a table."""
        for index, truth in self.stream.labels(reader):
            self._writer.label_frame(index, truth)
        if not self._plan.redact:
            self._writer.set_poses(self.stream.poses.values)
        counts = self.stream.buffer.counts
        if counts.disordered:
            self._faults.add("TIM001", self.stream.reference, counts.disordered)
        self._writer.explain_missing(self._missing.explain)
        self._count_shortages()
        if isinstance(self._plan.pipeline, GivesWarnings):
            with guard(f"pipeline '{self._plan.name}' can't give its warnings"):
                warnings = tuple(self._plan.pipeline.warnings())
                check_faults("warnings()", warnings)
            for warning in warnings:
                self._faults.add(warning.code, warning.where)
        rows = self._faults.rows()
        if self._plan.redact:
            self._writer.explain_missing(redact_record)
            rows = redact_rows(rows)
        self._writer.write_media(self._media.frames)
        faults = {"lost": self._faults.num_lost, "late_messages": counts.late, "unused_messages": counts.unused}
        self._writer.write_json("faults.json", {**faults, "rows": rows})

    def _count_shortages(self) -> None:
        """Count the sensors that the pipeline needs and hardly any frame has as data that were lost."""
        pipeline, records = self._plan.pipeline, self._writer.records
        is_enough = self._plan.excerpt.is_whole or len(records) >= LEAST_FRAMES
        is_enough = is_enough and not self._plan.disturbance  # what conditions take away isn't lost
        if not isinstance(pipeline, NeedsSensors) or not is_enough:
            return
        with guard(f"pipeline '{self._plan.name}' can't say which sensors it needs"):
            needed = sorted(set(pipeline.required_sensors() or ()) & set(self.stream.buffer.counts.arrivals))
        for shortage in self._missing.find_shortages(needed, records, self.stepper.rig.kinds):
            self._faults.add("FRM001", f"{shortage.sensor} {shortage.text}; {shortage.advice}")

    def manifest(self) -> manifest.Manifest:
        """Say what ran. Raises RunError where the pipeline's identity fails, or is what JSON can't hold."""
        plan, stream, info, records = self._plan, self.stream, self._info, self._writer.records
        identity: dict[str, object] = {}
        if isinstance(plan.pipeline, TellsIdentity):
            with guard(f"pipeline '{plan.name}' can't say what tells it apart"):
                identity = dict(plan.pipeline.identity())
                json.dumps(identity, allow_nan=False)
        first, *changed = (manifest.rig_entry(segment, rig) for segment, rig in sorted(stream.rigs.items()))
        latency = None
        if plan.latency is not None:
            how: dict[str, object] = {
                "profile": plan.latency.entry,
                "service_ns": plan.latency.fixed_ns,
                "overload": str(plan.latency.policy),
            }
            how |= {"rate": float(plan.latency.rate), "num_dropped": self._num_dropped}
            latency = manifest.LatencyEntry.model_validate(how)
        limits = ("timeout_ns", "tolerance_ns", "max_gap_ns", "max_jump_ns")
        metadata = dict(sorted(info.metadata.items()))
        frames = manifest.FrameEntry(
            reference=stream.reference,
            **{name: getattr(stream.sync, name) for name in limits},
            stamps=plan.stamps.source,
            offsets_ns=dict(plan.stamps.offsets_ns),
            topics=list(plan.topics),
            sensors=list(plan.sensors),
            excerpt=str(plan.excerpt),
        )
        content = manifest.Manifest(
            has_tracks=self._has_tracks(),
            complete=not plan.budget.find_exceeded(self._faults),
            log=manifest.LogEntry(name=info.name, log_id=info.log_id, digest=stream.digest.hex(), metadata=metadata),
            pipeline=plan.name,
            parameters={**plan.parameters, **identity},
            variant=plan.variant,
            frames=frames,
            conditions=[manifest.condition_entry(part) for part in plan.disturbance.parts],
            seed=plan.disturbance.seed if plan.disturbance else None,
            effects=self._effects.rows(),
            inputs=list(plan.inputs),
            truth=plan.truth,
            interpolation=manifest.InterpolationEntry(max_gap_ns=plan.max_between_ns, num_frames=stream.num_between),
            latency=latency,
            execution=manifest.execution_entry(),
            mounts=first.mounts,
            cameras=first.cameras,
            images=dict(sorted(self._media.sizes_wh.items())),
            rig_changes=changed,
            num_frames=len(records),
            num_segments=len({record.segment for record in records}),
            digest=self._chain,
            versions=manifest.package_versions(),
        )
        return redact_manifest(content) if plan.redact else content
