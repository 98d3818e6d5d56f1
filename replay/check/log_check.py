"""Reading a whole log once, every checksum verified and every payload decoded, to find what is wrong."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from fbench.replay.check.findings import SEVERITIES, Finding, Severity, finding
from fbench.replay.check.survey import Topic, reference_of, topics_of
from fbench.replay.check.times import StreamStats, Times, stream_stats, time_findings, timeline
from fbench.replay.check.trial import FrameCheck, FrameStats, Trial
from fbench.replay.check.truth import TruthCheck, TruthClock
from fbench.replay.contracts.errors import DecodeError
from fbench.replay.contracts.faults import FAULTS, UNREAD_SENSOR, UNVERIFIED, FaultLog
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.images import LAYOUTS, decode, read_size
from fbench.replay.data.messages import BOXES, Image, Message
from fbench.replay.data.metadata import GAPS, MEANT
from fbench.replay.data.rig import LogInfo, RigChange
from fbench.replay.engine.cleaning import clean
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.bursts import join_bursts
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.open import Storage, storage
from fbench.replay.logs.partial_rig import PartialRig, partial_rig
from fbench.replay.logs.reader import LogReader, make_tick
from fbench.replay.logs.setup import StampParams

_ENDS = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_TAIL = 1024  # Some cameras pad their images; the end is looked for in so many bytes


def _find_damage(image: Image, decode_images: bool) -> str:
    width, height = image.size_wh
    if image.video is not None:  # what headers tell is found by `clean`
        return "can't be decoded" if decode_images and not image.video.damage and decode(image) is None else ""
    if image.encoding in LAYOUTS:
        layout = LAYOUTS[image.encoding]
        wanted = layout.num_rows(height) * width * layout.pixel_bytes
        if len(image.data) != wanted:
            return f"{len(image.data)} bytes, but {width}x{height} px need {wanted}"
    else:
        try:
            encoded = read_size(image.data)
        except DecodeError as error:
            return str(error)
        if encoded != image.size_wh:
            return f"{encoded[0]}x{encoded[1]} px, but {width}x{height} recorded"
        end = _ENDS.get(image.encoding)
        if end is not None and end not in image.data[-_TAIL:]:
            return "cut off"
    return "can't be decoded" if decode_images and decode(image) is None else ""


@dataclass(frozen=True)
class CheckOptions:
    """What to check and how."""

    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    decode_images: bool = False  # All images, not only their headers
    pipeline: tuple[str, Pipeline] | None = None  # Name and pipeline, to say what it would miss
    sensors: tuple[str, ...] = ()  # Patterns of those that frames wait for and the pipeline gets; empty: all
    ignored: tuple[str, ...] = ()  # Codes that count as information only
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
    num_truths: int  # Messages of ground truth; `num_labeled` frames have some
    num_labeled: int
    findings: tuple[Finding, ...]

    @property
    def num_problems(self) -> int:
        """Errors and warnings."""
        return sum(f.severity != "info" for f in self.findings)


def check_log(reader: LogReader, faults: FaultLog, options: CheckOptions) -> CheckResult:
    """Check a log; memory grows by some 24 bytes a message. What the reader counts in `faults` becomes findings. Raises
    LogError where the log can't be read, ConfigError where the reference, a sensor with an offset or a chosen sensor
    isn't in it, FbenchError where the pipeline's configuration is wrong.
    """
    job = _Check(reader, faults, options)
    for event in join_bursts(job.read(), frozenset(reader.bursts)):
        job.take(event)
    reader.container.verify()
    return job.finish()


class _Check:
    def __init__(self, reader: LogReader, faults: FaultLog, options: CheckOptions) -> None:
        options = replace(options, sync=options.sync.complete_from(reader.info))
        self._reader, self._faults, self._options = reader, faults, options
        self._known: PartialRig = partial_rig(reader)
        self._rig = self._known.rig
        self._reference = reference_of(reader, self._known, options.sync)
        chosen = choose_sensors(self._known.kinds, options.sensors)
        options.stamps.require_known((*self._known.kinds, *reader.poses))
        self._kinds: dict[str, str] = {**dict.fromkeys(reader.poses, "pose"), **self._known.kinds}
        left_out = frozenset(self._known.kinds) - frozenset(chosen)
        self._trial = None if options.pipeline is None else Trial(*options.pipeline, reader, left_out)
        self._frames: FrameCheck | None = None
        if self._reference is not None:
            self._frames = FrameCheck((*chosen, *reader.poses), self._reference, options.sync, self._trial)
        self._times = {name: Times() for name in sorted(self._kinds)}
        self._truth, self._truth_clock = TruthCheck(), TruthClock()

    def read(self) -> Iterator[Message | RigChange]:
        """Yield measurements, poses and changes of the rig as recorded; their times and all truth are noted."""
        for num, (entry, item) in enumerate(self._reader.everything()):
            if num % 256 == 0:
                self._options.progress(num)
            if isinstance(item, TruthPart):
                if entry.channel in self._reader.tick_channels and self._frames is not None:
                    tick = make_tick(entry, item)
                    self._frames.add(tick, tick, None)
                if self._reader.roles[entry.channel].kind == "truth":
                    self._truth.add(item.truth)
                    self._truth_clock.add_truth(item.truth)
            elif item is not None:
                if not isinstance(item, RigChange):
                    message = self._options.stamps.restamp(item)
                    self._times.setdefault(message.sensor, Times()).add(entry, message)
                yield item

    def take(self, event: Message | RigChange) -> None:
        """Take a whole measurement into frames, or a change of the rig."""
        if isinstance(event, RigChange):
            self._faults.add("CAL002", f"{event.reason} at {event.log_ns} ns")
            self._rig = event.rig
            if self._frames is not None:
                self._frames.change(event)
            return
        message = self._options.stamps.restamp(event)
        if isinstance(message, Image) and (why := _find_damage(message, self._options.decode_images)):
            self._faults.add("DEC002", f"{message.sensor} at {message.stamp_ns} ns: {why}")
        usable = clean(message, self._rig, self._faults)
        self._truth_clock.add_sweep(usable, self._rig)
        if self._frames is not None:
            self._frames.add(event, message, usable)

    def finish(self) -> CheckResult:
        sync, reader, num_labeled = self._options.sync, self._reader, 0
        if self._frames is not None:
            self._frames.flush()
        lines = {name: timeline(times, sync.max_jump_ns) for name, times in self._times.items()}
        stats = {name: stream_stats(name, self._kinds.get(name, ""), line, sync.max_gap_ns)
                 for name, line in lines.items()}  # fmt: skip
        goes_on = self._trial is not None and self._trial.has_started  # with what cameras lack
        found = [
            finding("CAL001", name, why, severity="info" if goes_on and self._known.kinds[name] == "camera" else None)
            for name, why in sorted(self._known.problems.items())
        ]
        found += self._fault_findings()
        no_message = "the rig has it, but the log has no message of it"
        severity: Severity | None = "info" if self._reference == BOXES else None
        silent = [name for name, s in stats.items() if not s.num_messages]
        found += [finding("CHK005", name, no_message, 0, severity=severity) for name in silent]
        if self._reference is None:
            found.append(finding("CHK007", "", "no frames: neither sensors nor boxes have messages"))
        for name, line in lines.items():
            of_times = time_findings(stats[name], line, stats.get(self._reference or ""))
            found += [one for one in of_times if one.code != "TIM003" or name not in reader.bursts]
        found += self._truth_clock.findings(self._options.stamps.offsets_ns, self._reference)
        if self._frames is not None:
            found += self._truth.findings(*self._frames.stamps)
            num_labeled = int(self._truth.find_labeled(*self._frames.stamps).sum())
        frames, short = None if self._frames is None else self._frames.stats, self._find_short()
        found += short
        if self._trial is not None:
            found += self._trial.findings(frames, sync, {one.source for one in short})
        ignored = set(self._options.ignored)
        if reader.info.metadata.get(GAPS) == MEANT:
            ignored.add("TIM007")
        found = [replace(f, severity="info") if f.code in ignored else f for f in found]
        return CheckResult(
            reader.info, storage(reader.container, reader.container.log_times()), self._reference,
            tuple(stats.values()), topics_of(reader), frames, self._truth.num_messages, num_labeled,
            tuple(sorted(found, key=lambda f: (SEVERITIES.index(f.severity), f.code, f.source, f.text))),
        )  # fmt: skip

    def _fault_findings(self) -> Iterator[Finding]:
        """Report what was counted while the log was read. What its format can't have is no fault of the log."""
        for code, num in sorted(self._faults.counts.items()):
            places, text = self._faults.places.get(code, []), f"{FAULTS[code].text}: {num}"
            first = places[0] if places else ""
            if code == UNVERIFIED and not self._reader.container.keeps_checksums:
                text = "the format has no checksums, so damage could go unnoticed"
                yield finding(code, "", text, num, first, "info", "nothing; fbench log convert writes a log with them")
            elif code == UNREAD_SENSOR:
                yield from (finding(code, "", place) for place in places)
            else:
                yield finding(code, "", text, num, first)

    def _find_short(self) -> list[Finding]:
        """Report the sensors that came, but are in hardly any frame: all, or those that the pipeline needs."""
        if self._frames is None:
            return []
        required = None if self._trial is None else self._trial.required
        found = self._frames.shortages(self._known.kinds)
        return [
            finding(
                "FRM001", one.sensor, one.text,
                severity="info" if required is not None and one.sensor not in required else None, advice=one.advice,
            )
            for one in found
        ]  # fmt: skip
