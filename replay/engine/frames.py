"""Frames of a log: messages in, the chosen frames out."""

from collections.abc import Iterator, Sequence

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.protocols import Reader
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import BOXES, Message, Pose, Tick, Truth
from fbench.replay.data.rig import Rig, RigChange
from fbench.replay.engine.cleaning import Skipped, SkippedMessages, clean
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import FrameBuffer, SyncParams, choose_reference
from fbench.replay.engine.poses import FramePoses
from fbench.replay.logs.setup import ClockCheck, StampParams
from fbench.replay.runs.digest import Digest
from fbench.replay.truth.labelling import Instant, drop_invalid, stray
from fbench.replay.truth.times import TruthTimes


class FrameStream:
    """Reads a log from its beginning, so that a frame's index and content don't depend on which ones are chosen, and up
    to the last chosen one. Raises ConfigError where the reference, a sensor with an offset or a chosen sensor isn't in
    the log. Raises LogError where the log has no message of any sensor with calibration.
    """

    def __init__(
        self,
        reader: Reader,
        sync: SyncParams,
        stamps: StampParams,
        excerpt: Excerpt,
        clock: Clock,
        faults: FaultLog,
        sensors: Sequence[str] = (),
        max_between_ns: int = 0,
    ) -> None:
        whole = reader.rig
        names = whole.sensors("camera", "lidar", "radar")
        chosen = choose_sensors(names, sensors)
        self._left_out = frozenset(names) - frozenset(chosen)
        self.rig: Rig = whole.without(self._left_out)
        """The chosen sensors; which they are changes neither instants nor segments nor the log's digest."""
        self.rigs = {0: whole}  # Of the log, in the first segment and in those from which on another one holds
        self._stamps, self._excerpt, self._clock, self._faults = stamps, excerpt, clock, faults
        self.sync = sync = sync.complete_from(reader.info)
        self._max_between_ns = max_between_ns
        self.reference = choose_reference(whole.kinds, reader.info, reader.num_messages, sync)
        self._known = (*names, *reader.poses)
        stamps.require_known(self._known)
        self.buffer = FrameBuffer((*chosen, *reader.poses), self.reference, sync)
        self._clocks = ClockCheck(self.reference, stamps)
        self.digest = Digest()  # Of all messages and truth that were read
        self._start_ns: int | None = None
        self._num_released = 0
        self._stop, self._is_pacing = excerpt.stop, excerpt.is_whole
        self._instants: list[Instant] = []
        self._ticking: set[str] = set()  # Sensors whose instants come apart from their messages, which were disturbed
        self.poses = FramePoses(min(reader.poses, default=None))  # Of all frames that were opened
        self.skipped = SkippedMessages(sync.tolerance_ns)
        self.num_between = 0
        """Frames that have no truth of their own, but got some from the truths around them; see `TruthTimes`."""
        self.is_cut = False  # Whether reading stopped before the log's end

    def frames(self, reader: Reader) -> Iterator[Frame]:
        """Read the log and yield the chosen frames. Raises LogError where the clocks of sensors differ."""
        for frame in self._release(reader):
            self._num_released = frame.index + 1
            if self._instants[frame.index].is_chosen:
                yield frame

    def labels(self, reader: Reader) -> Iterator[tuple[int, Truth]]:
        """Read the truth and yield that of chosen frames, with their indices, in body coordinates at their instants.
        Raises LogError where it is in the world, and the log has no pose then.
        """
        stamps = [instant.stamp_ns for instant in self._instants if instant.is_chosen]
        first_ns, last_ns = min(stamps, default=0), max(stamps, default=-1)
        times = TruthTimes(self._instants, self.poses.values, self._max_between_ns)
        for index, truth in times.match(self._truths(reader)):
            if index is None:
                if self._excerpt.is_whole or first_ns <= truth.stamp_ns <= last_ns:
                    self._faults.add("GT006", stray(truth))
            elif self._instants[index].is_chosen:
                pose = self.poses.world_T_body(index)
                if (kept := drop_invalid(truth, index, pose, self.poses.is_known, self._faults)) is not None:
                    self.num_between += times.is_between(index)
                    yield index, kept

    def require_frames(self, log: str) -> None:
        """Refuse to go on without a frame. Raises LogError: saying why there is none."""
        if not self._instants:
            hint = "choose another with --reference"
            raise LogError(f"log '{log}' gives no frames: no message of '{self.reference}', {hint}")
        if not any(instant.is_chosen for instant in self._instants):
            stamps = [instant.stamp_ns for instant in self._instants]
            there = f"it has {len(stamps)} over {(max(stamps) - min(stamps)) / 1e9:.3f} s"
            raise LogError(f"log '{log}' has no frames in the range '{self._excerpt}'; {there}")

    def _release(self, reader: Reader) -> Iterator[Frame]:
        for recorded in reader.events() if self.reference == BOXES else reader.messages():
            self.digest.add(recorded)
            if isinstance(recorded, RigChange):  # ends the segment: what comes next was measured by other sensors
                yield from self.buffer.break_off(recorded.reason)
                self._faults.add("CAL002", f"{recorded.reason} at {recorded.log_ns} ns")
                self.rigs[self.buffer.segment] = recorded.rig
                self.rig = recorded.rig.without(self._left_out)
            elif isinstance(recorded, Tick) and recorded.sensor == BOXES:
                yield from self._take(recorded, recorded)
            else:
                yield from self._take(recorded, self._stamps.restamp(recorded))
            if self._stop is not None and self._num_released >= self._stop:
                self.is_cut = True
                break
        else:
            yield from self.buffer.flush()
        self.poses.finish()

    def _take(self, recorded: Message | Tick, message: Message | Tick) -> Iterator[Frame]:
        if message.sensor in self._known:
            self._clocks.check(message)
        if self._start_ns is None and (isinstance(message, Tick) or message.sensor in self._known):
            self._start_ns = message.stamp_ns
        yield from self.buffer.advance(message.log_ns)
        if isinstance(message, Pose):
            self.poses.add(message)
        if isinstance(message, Tick):
            self._ticking.add(message.sensor)
        if message.sensor == self.reference and (isinstance(message, Tick) or message.sensor not in self._ticking):
            yield from self._open(recorded, message)
        if self._is_pacing:
            self._clock.wait_until(message.log_ns)
        if isinstance(message, Tick) or message.sensor in self._left_out:
            return
        usable = clean(message, self.rig, self._faults)
        if isinstance(usable, Skipped):
            self.skipped.add(usable)
        else:
            yield from self.buffer.add(usable)

    def _open(self, recorded: Message | Tick, message: Message | Tick) -> Iterator[Frame]:
        """Open a frame, and decide whether it is chosen and whether it is the first behind the chosen ones."""
        buffer, num_breaks, index = self.buffer, len(self.buffer.breaks), self.buffer.num_frames
        yield from buffer.open_frame(message)
        for why in buffer.breaks[num_breaks:]:
            self._faults.add("TIM007" if why.startswith("gap") else "TIM005", why)
        if buffer.num_frames == index:
            return
        stamp_ns = message.stamp_ns
        start_ns = stamp_ns if self._start_ns is None else self._start_ns
        chosen = self._excerpt.has(index, stamp_ns, start_ns)
        if self._is_pacing and self._excerpt.is_past(index, stamp_ns, start_ns):
            self._stop = index if self._stop is None else min(index, self._stop)
        self._instants.append(Instant(index, recorded.stamp_ns, recorded.frame_number, chosen, buffer.segment))
        self.poses.open(index, stamp_ns)
        self._is_pacing = self._is_pacing or chosen

    def _truths(self, reader: Reader) -> Iterator[Truth]:
        last_ns = max((instant.stamp_ns for instant in self._instants), default=0)
        for truth in reader.truths():
            if self.is_cut and truth.stamp_ns > last_ns + max(self.sync.max_gap_ns, self._max_between_ns):
                return
            self.digest.add(truth)
            yield truth
