"""The frame buffer: puts the messages of all sensors that belong to one instant into one frame.

Instants are the stamps of a reference sensor as recorded. Other messages join by frame number where the log has
one, else by nearest stamp within a tolerance. A frame is released whole when every expected sensor has delivered,
or partial when the time-out has passed (thesis, Synchronization). It is counted in log time from the arrival of the
reference's message; in logs with frame numbers, from the first message of the frame.
"""

from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import BOXES, Message, Tick
from fbench.replay.data.metadata import REFERENCE, TIMEOUT_MS
from fbench.replay.data.rig import Kind, LogInfo

NOT_THERE = "not there within"
_REMEMBERED = 16
_PREFERENCE: tuple[Kind, ...] = ("lidar", "camera", "radar")


@dataclass(frozen=True)
class SyncParams:
    """How messages are put into frames."""

    reference: str | None = None
    """Sensor whose stamps are the frames' instants; `None`: as the log says, else a LiDAR, camera or radar."""
    timeout_ns: int = 30_000_000
    """How long a frame waits [ns], in log time: with frame numbers from its first arrival on; without them it is
    known only from the arrival of its reference message on."""
    tolerance_ns: int = 50_000_000
    """How far a stamp may be from the instant [ns]; never more than half a mean period of it or the reference."""
    max_gap_ns: int = 2_000_000_000  # A longer pause between two instants begins a new segment [ns]
    max_jump_ns: int = 1_000_000_000
    """A step back by more is a clock that was reset, and begins a new segment; by less, a message out of order [ns]."""
    is_default_timeout: bool = False  # Whether nobody asked for `timeout_ns`, so that what the log says counts

    def complete_from(self, info: LogInfo) -> "SyncParams":
        """Return the same with the time-out [ms] of a log's metadata, unless one was asked for."""
        text = info.metadata.get(TIMEOUT_MS, "")
        if not (self.is_default_timeout and text.isascii() and text.isdecimal() and len(text) < 10):
            return self
        return replace(self, timeout_ns=int(text) * 1_000_000)


def make_sync_params(
    reference: str | None, timeout_ms: float | None, tolerance_ms: float, max_gap_s: float
) -> SyncParams:
    """Read options; `None`: not given. Raises ConfigError where a duration isn't a number, or negative."""
    durations: list[int] = []
    asked = (("--timeout-ms", timeout_ms, 1e6), ("--tolerance-ms", tolerance_ms, 1e6), ("--max-gap-s", max_gap_s, 1e9))
    for option, value, unit_ns in asked:
        if value is not None and not value >= 0:
            raise ConfigError(f"{option} {value}: expected a duration, such as 20")
        # Infinity becomes longer than any log.
        durations.append(SyncParams.timeout_ns if value is None else round(min(value * unit_ns, 1e18)))
    timeout_ns, tolerance_ns, max_gap_ns = durations
    return SyncParams(reference, timeout_ns, tolerance_ns, max_gap_ns, is_default_timeout=timeout_ms is None)


def choose_reference(kinds: Mapping[str, Kind], info: LogInfo, nums: Mapping[str, int], params: SyncParams) -> str:
    """Return the name of the reference sensor: as asked for, as the log says, else the slowest. `kinds`: of calibrated
    sensors by name.

    The slowest is the one with the fewest messages (`nums`); up to a tenth more counts as equally slow, since messages
    get lost. Of equally slow ones LiDARs go before cameras before radars, then names decide. Where no sensor has
    messages, boxes give the instants: `BOXES`. Raises ConfigError where the sensor that was asked for isn't in the log.
    Raises LogError where the log has no message of any sensor with calibration.
    """
    logged = info.metadata.get(REFERENCE)
    wanted = params.reference or (logged if logged in kinds else None)  # it may have been left out
    if wanted is not None:
        if wanted not in kinds:
            raise ConfigError(f"reference sensor '{wanted}' isn't in the log; it has: {', '.join(sorted(kinds))}")
        return wanted
    heard = {name: num for name, kind in kinds.items() if kind in _PREFERENCE and (num := nums.get(name, 0))}
    if not heard and nums.get(BOXES):
        return BOXES
    if not heard:
        raise LogError(f"log '{info.name}' has no messages of a sensor with calibration, so there are no frames")
    slow = [name for name, num in heard.items() if num <= 1.1 * min(heard.values())]
    return min(slow, key=lambda name: (_PREFERENCE.index(kinds[name]), name))


@dataclass
class _Open:
    """A frame that waits for its sensors."""

    index: int
    stamp_ns: int
    segment: int
    number: int | None
    opened_ns: int
    messages: dict[str, Message] = field(default_factory=dict)

    def rank(self, message: Message) -> tuple[bool, int]:
        """Order of messages that could be the frame's: those with its number first, then the nearest."""
        is_own = message.frame_number is not None and message.frame_number == self.number
        return not is_own, abs(message.stamp_ns - self.stamp_ns)


class _Released(NamedTuple):
    """What is remembered of a frame, to recognize messages that come too late for it."""

    frame: int
    stamp_ns: int
    number: int | None
    deadline_ns: int
    absent: frozenset[str]


class _Periods:
    """Mean time between the messages of each sensor."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, int, int]] = {}

    def note(self, sensor: str, stamp_ns: int) -> None:
        first, _, num = self._seen.get(sensor, (stamp_ns, stamp_ns, 0))
        self._seen[sensor] = (first, stamp_ns, num + 1)

    def limit_ns(self, sensor: str, otherwise_ns: int) -> int:
        """Farther than half a mean period away another message of the sensor is nearer; a fiftieth more, so that an
        instant half way between two messages gets one of them whatever their jitter.
        """
        first, last, num = self._seen.get(sensor, (0, 0, 0))
        return min(otherwise_ns, (last - first) * 51 // (100 * (num - 1))) if num > 1 and last > first else otherwise_ns


@dataclass
class Arrivals:
    """The messages of one sensor that came: how many and when; of those in no frame each one."""

    num: int = 0
    first_ns: int = 0  # Smallest stamp and largest
    last_ns: int = 0
    unused_stamp_ns: "array[int]" = field(default_factory=lambda: array("q"))
    unused_log_ns: "array[int]" = field(default_factory=lambda: array("q"))

    def note(self, stamp_ns: int) -> None:
        """Count a message."""
        self.first_ns = min(self.first_ns, stamp_ns) if self.num else stamp_ns
        self.last_ns = max(self.last_ns, stamp_ns) if self.num else stamp_ns
        self.num += 1


@dataclass
class SyncCounts:
    """What became of the messages that are in no frame, and what was late."""

    late_ms: dict[tuple[int, str], float]
    """How much too late a message came for a frame that lacks it, by frame index and sensor."""
    unused: dict[str, int]  # Messages that no frame needed, by sensor
    disordered: int  # Messages of the reference sensor that opened no frame, since a later one had come before them
    arrivals: dict[str, Arrivals]  # Of all expected sensors

    def leave_out(self, message: Message) -> None:
        """Count a message that is in no frame, and no frame waits for."""
        own = self.arrivals[message.sensor]
        self.unused[message.sensor] += 1
        own.unused_stamp_ns.append(message.stamp_ns)
        own.unused_log_ns.append(message.log_ns)

    @property
    def late(self) -> dict[str, int]:
        """Messages that came after the release of the frame that lacks them, by sensor."""
        sensors = Counter(sensor for _, sensor in self.late_ms)
        return {sensor: sensors[sensor] for sensor in self.unused}


class FrameBuffer:
    """Collects messages, given in canonical order, into frames, released in the order of their instants."""

    def __init__(self, expected: Sequence[str], reference: str, params: SyncParams) -> None:
        self._expected, self._reference, self._params = tuple(sorted(expected)), reference, params
        self._open: list[_Open] = []
        self._pending: list[Message] = []
        self._released: list[_Released] = []
        self.num_frames, self.segment, self._first_of_segment = 0, 0, 0
        """Frames opened so far, and the segment of the one that opens next, as far as it is known."""
        self.breaks: list[str] = []  # Why each segment after the first begins
        self._last_stamp_ns: int | None = None
        self._periods = _Periods()
        self.counts = SyncCounts(
            {}, dict.fromkeys(self._expected, 0), 0, {name: Arrivals() for name in self._expected}
        )  # What was late or unused so far
        self.opened_ns = array("q")  # Log time at which each frame opened, by its index
        self.ready_ns = array("q")
        """Log time at which each frame was there, by its index: complete, or given up for by time-out."""
        self.first_ns = array("q")  # Log time at which the first message of each frame arrived, by its index
        self._is_numbered = False  # Whether frames have numbers, all of them or some

    def open_frame(self, message: Message | Tick) -> Iterator[Frame]:
        """Open the frame at the instant of a message of the reference sensor, as recorded. Yields the frames of the
        segment that ends where a gap or a jump of the clock is. A message that is merely out of order, or a repeated
        stamp, opens no frame, so that time never stands still or runs back within a segment.
        """
        stamp = message.stamp_ns
        step_ns = 1 if self._last_stamp_ns is None else stamp - self._last_stamp_ns
        if self._last_stamp_ns is not None and step_ns > self._params.max_gap_ns:
            yield from self.break_off(f"gap of {step_ns / 1e9:.3f} s")
        elif -step_ns > self._params.max_jump_ns:
            yield from self.break_off(f"clock jumps back by {-step_ns / 1e9:.3f} s")
        elif step_ns <= 0:
            self.counts.disordered += 1
            return
        self._last_stamp_ns = stamp
        self._periods.note(self._reference, stamp)
        self._is_numbered = self._is_numbered or message.frame_number is not None
        frame = _Open(self.num_frames, stamp, self.segment, message.frame_number, message.log_ns)
        self.num_frames += 1
        self.opened_ns.append(message.log_ns)
        self._open.append(frame)
        # The frame gets the messages that came before it; those that no later frame can want are dropped.
        waiting, self._pending = self._pending, []
        for early in waiting:
            if self._distance_ns(early, frame) is not None:
                self._join(frame, early)
            elif early.stamp_ns > stamp or (early.frame_number is not None and frame.number is None):
                self._pending.append(early)
            else:
                self.counts.leave_out(early)

    def break_off(self, why: str) -> Iterator[Frame]:
        """Release all frames and begin a new segment with the next one, where there were frames already."""
        yield from self._release_all()
        self._periods, self._released = _Periods(), []
        if self.num_frames and self.num_frames != self._first_of_segment:
            self.breaks.append(f"{why} before frame {self.num_frames}")
            self.segment, self._first_of_segment = self.segment + 1, self.num_frames

    def add(self, message: Message) -> Iterator[Frame]:
        """Put a message into its frame, or keep it until that opens, but not for longer than a segment can pause."""
        if message.sensor not in self.counts.unused:
            return
        yield from self.advance(message.log_ns)
        self.counts.arrivals[message.sensor].note(message.stamp_ns)
        if message.sensor != self._reference:
            self._periods.note(message.sensor, message.stamp_ns)
        near = [(d, f.index, f) for f in self._open if (d := self._distance_ns(message, f)) is not None]
        if near:
            self._join(min(near, key=lambda n: n[:2])[2], message)
        elif not self._is_late(message):
            oldest = message.log_ns - self._params.max_gap_ns
            for old in [m for m in self._pending if m.log_ns < oldest]:
                self.counts.leave_out(old)
            self._pending = [*(m for m in self._pending if m.log_ns >= oldest), message]
        yield from self.advance(message.log_ns)

    def advance(self, now_ns: int) -> Iterator[Frame]:
        """Release the frames whose time-out has passed at log time `now_ns`, and complete ones before them."""
        while self._open:
            first, is_complete = self._open[0], all(name in self._open[0].messages for name in self._expected)
            if not (is_complete or now_ns > self._deadline_ns(first)):
                return
            yield self._release(self._open.pop(0))

    def flush(self) -> Iterator[Frame]:
        """Release all frames: the log ends."""
        yield from self._release_all()
        for message in self._pending:
            self.counts.leave_out(message)
        self._pending = []

    def _release_all(self) -> Iterator[Frame]:
        while self._open:
            yield self._release(self._open.pop(0))

    def _deadline_ns(self, frame: _Open) -> int:
        arrivals = () if frame.number is None else (m.log_ns for m in frame.messages.values())
        return min(arrivals, default=frame.opened_ns) + self._params.timeout_ns

    def _distance_ns(self, message: Message, frame: _Open | _Released) -> int | None:
        """How far a message is from a frame's instant, or `None` where it doesn't belong there."""
        # Where only some frames have numbers, as keyframes do, a message with a number belongs to no other.
        if message.frame_number is not None and (frame.number is not None or self._is_numbered):
            return 0 if message.frame_number == frame.number else None
        distance = abs(message.stamp_ns - frame.stamp_ns)
        limit = self._periods.limit_ns(self._reference, self._params.tolerance_ns)
        return distance if distance <= self._periods.limit_ns(message.sensor, limit) else None

    def _join(self, frame: _Open, message: Message) -> None:
        """Take the message; of two of one sensor that with the frame's number stays, else the nearer or earlier one."""
        other = frame.messages.setdefault(message.sensor, message)
        if other is not message:
            is_better = frame.rank(message) < frame.rank(other)
            self.counts.leave_out(other if is_better else message)
            if is_better:
                frame.messages[message.sensor] = message

    def _is_late(self, message: Message) -> bool:
        """Tell whether the message belongs to a released frame; where that lacks it, note by how much it is late."""
        for frame in reversed(self._released):
            if self._distance_ns(message, frame) is not None:
                key = (frame.frame, message.sensor)
                if message.sensor in frame.absent and key not in self.counts.late_ms:
                    self.counts.late_ms[key] = max(0, message.log_ns - frame.deadline_ns) / 1e6
                else:
                    self.counts.leave_out(message)
                return True
        return False

    def _release(self, frame: _Open) -> Frame:
        absent = [name for name in self._expected if name not in frame.messages]
        arrived_ns = max((frame.opened_ns, *(message.log_ns for message in frame.messages.values())))
        own_ns = max(frame.opened_ns, self._deadline_ns(frame)) if absent else arrived_ns
        self.ready_ns.append(max(own_ns, self.ready_ns[-1]) if self.ready_ns else own_ns)
        self.first_ns.append(min((frame.opened_ns, *(message.log_ns for message in frame.messages.values()))))
        released = _Released(frame.index, frame.stamp_ns, frame.number, self._deadline_ns(frame), frozenset(absent))
        self._released = [*self._released[1 - _REMEMBERED :], released]
        missing = dict.fromkeys(absent, f"{NOT_THERE} {self._params.timeout_ns / 1e6:g} ms")
        messages = dict(sorted(frame.messages.items()))
        return Frame(frame.index, frame.stamp_ns, frame.segment, messages, missing, frame.number)
