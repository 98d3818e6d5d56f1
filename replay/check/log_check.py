"""Reading a whole log once, every checksum verified and every payload decoded, to find what is wrong."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.replay.check.findings import Finding, Severity, finding, sort_key
from fbench.replay.check.survey import Topic, reference_of, topics_of
from fbench.replay.check.times import StreamStats, Times, stream_stats, time_findings, timeline
from fbench.replay.check.trial import FrameCheck, FrameStats, Trial, missing_findings
from fbench.replay.check.truth import TruthCheck, TruthClock
from fbench.replay.contracts.errors import DecodeError, LogError
from fbench.replay.contracts.faults import FAULTS, FaultLog
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.contracts.sensor_settings import chosen_sensors
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import LAYOUTS, decode, encoded_size
from fbench.replay.data.messages import BOXES, Image, Message, Pose
from fbench.replay.data.metadata import GAPS, MEANT
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.engine.cleaning import Skipped, clean
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import Entry
from fbench.replay.logs.open import Storage, storage
from fbench.replay.logs.partial_rig import PartialRig, partial_rig
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import StampParams

_ENDS = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_TAIL = 1024  # Some cameras pad their images; the end is looked for in so many bytes


def checked(message: Message, rig: Rig, faults: FaultLog, decode_images: bool) -> Message | Skipped:
    """Count what is wrong with a message; returns it as a pipeline would get it."""
    if isinstance(message, Image) and (why := _damage(message, decode_images)):
        faults.add("DEC002", f"{message.sensor} at {message.stamp_ns} ns: {why}")
    return clean(message, rig, faults)


def bad_pose(message: Message) -> bool:
    """Tell whether this is a pose that places the body nowhere."""
    if not isinstance(message, Pose):
        return False
    finite = np.isfinite(message.translation_m).all() and np.isfinite(message.rotation_xyzw).all()
    return not (finite and np.any(message.rotation_xyzw))


def _damage(image: Image, decode_images: bool) -> str:
    why = _raw_damage(image) if image.encoding in LAYOUTS else _header_damage(image)
    if not why and decode_images and decode(image) is None:
        return "can't be decoded"
    return why


def _raw_damage(image: Image) -> str:
    layout, (width, height) = LAYOUTS[image.encoding], image.size_wh
    wanted = layout.num_rows(height) * width * layout.pixel_bytes
    return "" if len(image.data) == wanted else f"{len(image.data)} bytes, but {width}x{height} px need {wanted}"


def _header_damage(image: Image) -> str:
    try:
        width, height = encoded_size(image.data)
    except DecodeError as error:
        return str(error)
    if (width, height) != image.size_wh:
        return f"{width}x{height} px, but {image.size_wh[0]}x{image.size_wh[1]} recorded"
    end = _ENDS.get(image.encoding)
    return "cut off" if end is not None and end not in image.data[-_TAIL:] else ""


_GAP = "TIM007"


@dataclass(frozen=True)
class CheckOptions:
    """What to check and how."""

    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    decode_images: bool = False
    """Decode all images, not only their headers."""
    pipeline: tuple[str, Pipeline] | None = None
    """Name and pipeline, to say what it would miss."""
    sensors: tuple[str, ...] = ()
    """Patterns of the sensors that frames wait for and the pipeline gets; empty: all."""
    ignored: tuple[str, ...] = ()
    """Codes that count as information only."""
    progress: Callable[[int], None] = lambda num_messages: None


@dataclass(frozen=True)
class CheckResult:
    """What was found."""

    info: LogInfo
    storage: Storage
    reference: str | None
    streams: tuple[StreamStats, ...]
    topics: tuple[Topic, ...]
    frames: FrameStats | None  # `None` where no sensor can be the reference
    num_truths: int  # Messages of ground truth; `num_labelled` frames have some
    num_labelled: int
    findings: tuple[Finding, ...]

    @property
    def num_problems(self) -> int:
        """Errors and warnings."""
        return sum(f.severity != "info" for f in self.findings)


def check_log(reader: LogReader, faults: FaultLog, options: CheckOptions) -> CheckResult:
    """Check a log; memory grows by some 24 bytes a message.

    Args:
        reader: The log.
        faults: Where the reader counts; they become findings.
        options: What to check.

    Raises:
        LogError: where the log can't be read.
        ConfigError: where the reference, a sensor with an offset or a chosen sensor isn't in the log.
        FbenchError: where the pipeline's configuration is wrong.
    """
    job = _Check(reader, faults, options)
    job.run()
    return job.result()


class _Check:
    """The state of one check."""

    def __init__(self, reader: LogReader, faults: FaultLog, options: CheckOptions) -> None:
        options = replace(options, sync=options.sync.told_by(reader.info))
        self._reader, self._faults, self._options = reader, faults, options
        self._known: PartialRig = partial_rig(reader)
        self._rig = self._known.rig
        self._reference = reference_of(reader, self._known, options.sync)
        chosen = chosen_sensors(self._known.kinds, options.sensors)
        self._left_out = frozenset(self._known.kinds) - frozenset(chosen)
        expected = (*chosen, *reader.poses)
        options.stamps.require_known((*self._known.kinds, *reader.poses))
        self._kinds: dict[str, str] = {**dict.fromkeys(reader.poses, "pose"), **self._known.kinds}
        self._frames = None if self._reference is None else FrameCheck(expected, self._reference, options.sync)
        self._trial = None if options.pipeline is None else Trial(*options.pipeline)
        self._times = {name: Times() for name in sorted(self._kinds)}
        self._truth, self._truth_clock = TruthCheck(), TruthClock()
        self._bad_poses: dict[str, tuple[int, int]] = {}
        self._found: list[Finding] = []

    def run(self) -> None:
        """Read the log."""
        if self._trial is not None:
            self._start(self._trial)
        for num, (entry, item) in enumerate(self._reader.everything()):
            self._take(entry, item)
            if num % 256 == 0:
                self._options.progress(num)
        self._reader.container.verify()
        if self._frames is not None:
            self._offer(self._frames.flush())
        if self._trial is not None:
            self._trial.finish()

    def _start(self, trial: Trial) -> None:
        rig: Rig | None = None
        with suppress(LogError):  # what is missing of the rig is a finding already
            rig = self._reader.rig
        if rig is None:
            trial.problems.append(finding("CHK008", "", f"{trial.name} can't start: the rig is incomplete"))
        else:
            trial.start(rig.without(self._left_out), self._reader.info)

    def _take(self, entry: Entry, item: Message | RigChange | TruthPart | None) -> None:
        if isinstance(item, RigChange):
            self._change(item)
        elif isinstance(item, TruthPart):
            if entry.channel in self._reader.tick_channels and self._frames is not None:
                tick = self._reader.tick(entry)
                self._offer(self._frames.tick(tick) if tick is not None else iter(()))
            if self._reader.roles[entry.channel].kind == "truth":
                self._truth.add(item.truth)
                self._truth_clock.add_truth(item.truth)
        elif item is not None:
            self._message(entry, item)

    def _change(self, change: RigChange) -> None:
        self._faults.add("CAL002", f"{change.reason} at {change.log_ns} ns")
        self._rig = change.rig
        if self._frames is not None:
            self._offer(self._frames.change(change))

    def _message(self, entry: Entry, recorded: Message) -> None:
        message = self._options.stamps.restamped(recorded)
        self._times.setdefault(message.sensor, Times()).add(entry, message)
        if bad_pose(message):
            first, num = self._bad_poses.get(message.sensor, (message.stamp_ns, 0))
            self._bad_poses[message.sensor] = (first, num + 1)
        usable = checked(message, self._rig, self._faults, self._options.decode_images)
        self._truth_clock.add_sweep(usable, self._rig)
        if self._frames is not None:
            self._offer(self._frames.add(recorded, message, usable))

    def _offer(self, frames: Iterator[Frame]) -> None:
        for frame in frames:
            if self._trial is not None:
                self._trial.offer(frame)

    def result(self) -> CheckResult:
        """Judge what was read."""
        sync = self._options.sync
        lines = {name: timeline(times, sync.max_jump_ns) for name, times in self._times.items()}
        stats = {
            name: stream_stats(name, self._kinds.get(name, ""), line, sync.max_gap_ns) for name, line in lines.items()
        }
        reference = stats.get(self._reference or "")
        frames = None if self._frames is None else self._frames.stats
        found = [*self._faulty(), *self._incomplete(list(stats.values()))]
        for name, line in lines.items():
            found += time_findings(stats[name], line, reference)
        num_labelled = 0
        if self._frames is not None:
            stamps = self._frames.stamps
            found += self._truth.findings(*stamps)
            num_labelled = int(self._truth.labelled(*stamps).sum())
        found += self._truth_clock.findings(self._options.stamps.offsets_ns, self._reference)
        if self._trial is not None:
            found += self._trial.problems
            found += missing_findings(self._trial, frames, sync) if frames is not None else []
        container = self._reader.container
        return CheckResult(
            self._reader.info, storage(container, container.log_times()), self._reference, tuple(stats.values()),
            topics_of(self._reader), frames, self._truth.num_messages, num_labelled,
            tuple(sorted((self._judged(f) for f in found), key=sort_key)),
        )  # fmt: skip

    def _judged(self, found: Finding) -> Finding:
        meant = found.code == _GAP and self._reader.info.metadata.get(GAPS) == MEANT
        return replace(found, severity="info") if meant or found.code in self._options.ignored else found

    def _faulty(self) -> Iterator[Finding]:
        """What was counted while reading."""
        for code, num in sorted(self._faults.counts.items()):
            places = self._faults.places.get(code, [])
            yield finding(code, "", f"{FAULTS[code].text}: {num}", num, places[0] if places else "")

    def _incomplete(self, stats: Sequence[StreamStats]) -> Iterator[Finding]:
        for sensor, why in sorted(self._known.problems.items()):
            yield finding("CAL001", sensor, why)
        for s in stats:
            if s.num_messages == 0:
                severity: Severity | None = "info" if self._reference == BOXES else None
                text = "the rig has it, but the log has no message of it"
                yield finding("CHK005", s.sensor, text, 0, severity=severity)
        for sensor, (stamp_ns, num) in sorted(self._bad_poses.items()):
            text = f"{num} poses aren't finite or have no rotation"
            yield finding("CHK006", sensor, text, num, f"stamp {stamp_ns} ns")
        if self._reference is None:
            yield finding("CHK007", "", "no frames: neither sensors nor boxes have messages")
