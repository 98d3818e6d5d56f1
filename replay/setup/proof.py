"""Proof of a drafted configuration: the log is read with it in two places, and what fails is left out or mended."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, takewhile
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import guard, open_pipeline
from fbench.replay.contracts.protocols import UsesLog
from fbench.replay.data.messages import Message, Tick, Truth
from fbench.replay.data.rig import RigChange
from fbench.replay.data.scores import format_count
from fbench.replay.engine.absence import Absences, Shortage, find_shortage
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import NOT_THERE
from fbench.replay.engine.frames import FrameStream
from fbench.replay.formats.documents import parse_toml
from fbench.replay.logs.codecs.plugin import NamedDecoder
from fbench.replay.logs.codecs.video.stream import BEFORE_KEY
from fbench.replay.logs.reader import LogReader
from fbench.replay.setup.configuration import Config, setup_of
from fbench.replay.setup.init import write_toml
from fbench.replay.setup.inspection import Draft, Line
from fbench.replay.setup.source import LogSource, name_decoder

_WINDOW_NS = 6_000_000_000
_MAX_MESSAGES = 3000  # Of a window
_MAX_ROUNDS = 60  # Each mends one thing
_LEAST_FRAMES = 5  # Fewer say nothing
_LEAST_POSED = 0.5  # So many frames at least must have a pose
_MAX_TIMEOUT_NS = 2_000_000_000
_NUM_BOXES = 20


@dataclass(frozen=True)
class Proof:
    """A draft that works, and what had to be done for it."""

    draft: Draft
    source: LogSource  # The log, read as the draft says
    remarks: tuple[str, ...]  # What was left out or changed, and why
    frames: str  # What frames were read
    failure: str = ""  # Why the log can't be read all the same; empty: it can


@dataclass(frozen=True)
class _Change:
    draft: Draft
    remark: str


def prove(draft: Draft, log: Path, config: Path, decoder: Sequence[str] = ()) -> Proof:
    """Read a log, through these decoders, as a draft of the file `config` says, and mend the draft until it can be
    read. Raises ConfigError where a decoder can't be used.
    """
    decoders = tuple(name_decoder(name, is_required=True) for name in decoder)
    remarks: list[str] = []
    while True:
        source = _source_of(draft, log, config, decoders)
        trial, failure = _Trial(draft, source), ""
        try:
            change = trial.find_change()
        except FbenchError as error:
            failure = str(error).removeprefix(f"{config}: ")
            change = _leave_out_culprit(draft, failure)
        if change is None or len(remarks) == _MAX_ROUNDS:
            return Proof(draft, source, tuple(remarks), trial.summary, failure)
        draft = change.draft
        remarks.append(change.remark)


def find_ready(source: LogSource, pipelines: Sequence[str]) -> dict[str, str]:
    """Start each of these pipelines on a log, and return why it can't, by its name; an empty text where it can."""
    found: dict[str, str] = {}
    reader = source.open(FaultLog())
    for name in pipelines:
        found[name] = ""
        try:
            with open_pipeline(name, []) as (pipeline, _), guard(f"pipeline '{name}' can't start"):
                if isinstance(pipeline, UsesLog):
                    pipeline.use_log(reader)
                pipeline.start(reader.rig, reader.info)
        except FbenchError as error:
            found[name] = str(error).removeprefix(f"log '{reader.info.name}': ")
    return found


def _source_of(draft: Draft, log: Path, config: Path, decoders: tuple[NamedDecoder, ...]) -> LogSource:
    content = Config.model_validate(parse_toml(write_toml(draft).text.encode()))
    offsets = {name: table.offset_ms for name, table in content.sensors.items()}
    setup = replace(setup_of(content, config), decoders=decoders)
    return LogSource(log, setup, content.frames, offsets)


class _Trial:
    """One draft, tried on its log."""

    def __init__(self, draft: Draft, source: LogSource) -> None:
        self._draft, self._source = draft, source
        self.summary = "no frames were read"

    def find_change(self) -> _Change | None:
        """Return the first change that the draft needs; `None`: it works. Raises FbenchError where it can't be read."""
        draft = self._draft
        reader = self._source.open(FaultLog())
        rig = reader.rig
        for topic in _topics(draft, "truth"):
            if (why := reader.try_boxes(topic, _NUM_BOXES)) is not None:
                return _drop_topic(draft, "truth", topic, why)
        for topic in _topics(draft, "results"):
            if (why := reader.try_boxes(topic, _NUM_BOXES)) is not None:
                return _drop_topic(draft, "results", topic, why)
        reference = draft.value(("frames",), "reference")
        if reference is not None and reference not in rig.kinds:
            return _drop_line(draft, ("frames",), "reference", f"the log has no usable sensor '{reference}'")
        windows = [_read_window(self._source, reader, start_ns) for start_ns in _starts(reader)]
        num, num_posed = sum(w.num for w in windows), sum(w.num_posed for w in windows)
        where = " in two places" if len(windows) > 1 else ""
        self.summary = f"read {format_count(num, 'frame')} by {windows[0].reference}{where}"
        if num < _LEAST_FRAMES:
            return None
        if reader.poses and num_posed < _LEAST_POSED * num:
            why = f"it gives a pose in {num_posed} of {num} frames: its stamps don't cover those of the sensors"
            return _next_pose(draft, why)
        return next((change for window in windows for change in self._mend_sensors(window, windows)), None)

    def _mend_sensors(self, window: "_Window", windows: Sequence["_Window"]) -> Iterator[_Change]:
        """Mend sensors that hardly any frame of a window has, though it is so in all windows."""
        for name, shortage in window.short.items():
            if any(name not in other.short and other.num >= _LEAST_FRAMES for other in windows):
                continue  # it began later, or ended
            path = ("sensors", name)
            shift_ns, late_ns = shortage.shift_ns, shortage.late_ns
            if shift_ns is not None and self._draft.value(path, "offset_ms") is None:
                why = f"its stamps seem to be {-shift_ns / 1e6:.0f} ms off; estimated from recording times"
                line = Line("offset_ms", float(round(shift_ns / 1e6)), why, is_guess=True)
                yield _Change(self._draft.with_line(path, line), f"{name}: offset_ms = {line.value}, {why}")
            elif late_ns is not None and late_ns < _MAX_TIMEOUT_NS:
                timeout_ms = float(-(-(window.timeout_ns + late_ns) // 5_000_000) * 5)
                why = f"{name} {shortage.text}"
                line = Line("timeout_ms", timeout_ms, why, is_guess=True)
                yield _Change(self._draft.with_line(("frames",), line), f"timeout_ms = {timeout_ms:g}: {why}")
            else:
                why = f"{shortage.text}; {shortage.advice}"
                yield _Change(self._draft.without_table(path, f"Left out: {why}"), f"left out {name}: it {why}")


@dataclass(frozen=True)
class _Window:
    """What became of the frames of one window."""

    num: int
    num_posed: int
    reference: str
    timeout_ns: int
    short: Mapping[str, Shortage]  # Sensors that hardly any frame has, though messages came


class _Part:
    """A part of a log, as a reader."""

    def __init__(self, reader: LogReader, start_ns: int | None) -> None:
        self._reader, self._start_ns = reader, start_ns
        self.info, self.rig, self.num_messages, self.poses = reader.info, reader.rig, reader.num_messages, reader.poses

    def messages(self) -> Iterator[Message | RigChange]:
        found = self._reader.messages(self._start_ns)
        first = next(found, None)
        if first is None:
            return
        yield first
        end_ns = first.log_ns + _WINDOW_NS
        yield from takewhile(lambda message: message.log_ns < end_ns, islice(found, _MAX_MESSAGES))

    def events(self) -> Iterator[Message | RigChange | Tick]:
        return islice(self._reader.events(), _MAX_MESSAGES)

    def truths(self) -> Iterator[Truth]:
        return iter(())


def _starts(reader: LogReader) -> list[int | None]:
    times = reader.container.log_times()
    known = [] if times is None else [t for t in times.values() if len(t)]
    if not known:
        return [None]
    first, last = min(int(t[0]) for t in known), max(int(t[-1]) for t in known)
    return [None] if last - first < 2 * _WINDOW_NS else [None, (first + last) // 2]


def _read_window(source: LogSource, reader: LogReader, start_ns: int | None) -> _Window:
    """Read a window, and judge each sensor by the frames that say something about it."""
    part = _Part(reader, start_ns)
    sync, stamps = source.sync_params(None, None, None, None), source.stamps(None, ())
    stream = FrameStream(part, sync, stamps, Excerpt(), Clock(), FaultLog())
    frames = list(stream.frames(part))
    absences, num = Absences(stream.buffer, stream.sync), len(frames)
    num_posed = int(np.isfinite(stream.poses.values).all(axis=1).sum())
    short: dict[str, Shortage] = {}
    for name in part.rig.sensors("camera", "lidar", "radar"):
        lacking = [f for f in frames if f.missing.get(name, "").startswith(NOT_THERE)]
        skipped = {f.index: stream.skipped.reason(name, f.stamp_ns, f.frame_number) for f in lacking}
        why = [absences.find(name, f.index, f.stamp_ns) for f in lacking if skipped[f.index] is None]
        # A window that begins between two keyframes of a video says nothing about the pictures up to the next one.
        num_unknown = sum(1 for reason in skipped.values() if reason is not None and reason.endswith(BEFORE_KEY))
        num_skipped = len(lacking) - len(why) - num_unknown
        if num - num_unknown < _LEAST_FRAMES:
            continue
        arrivals = stream.buffer.counts.arrivals[name]
        found = find_shortage(name, num - num_unknown, why, num_skipped, arrivals, stream.sync)
        if found is not None and not found.is_silent:
            short[name] = found
    return _Window(num, num_posed, stream.reference, stream.sync.timeout_ns, short)


def _topics(draft: Draft, table: str) -> tuple[str, ...]:
    value = draft.value((table,), "topics")
    return value if isinstance(value, tuple) else ()


def _drop_topic(draft: Draft, table: str, topic: str, why: str) -> _Change:
    """Leave a topic with boxes out; with the last one its line."""
    rest = tuple(name for name in _topics(draft, table) if name != topic)
    remark = f"{table}.topics: left out {topic}: {why}"
    if not rest and table != "truth":  # without a list of truth names of topics would tell
        return _Change(_drop_line(draft, (table,), "topics", f"{topic}: {why}").draft, remark)
    old = next(line for line in draft.table((table,)).lines if line.key == "topics")
    line = replace(old, value=rest, why=f"{old.why}; without {topic}: {why}")
    return _Change(draft.with_line((table,), line), remark)


def _drop_line(draft: Draft, path: tuple[str, ...], key: str, why: str) -> _Change:
    table = draft.table(path)
    lines = tuple(
        replace(line, is_active=False, is_guess=False, why=f"left out: {why}")
        if line.key == key and line.is_active
        else line
        for line in table.lines
    )
    return _Change(draft.with_table(replace(table, lines=lines)), f"left out {'.'.join(path)}.{key}: {why}")


def _next_pose(draft: Draft, why: str) -> _Change:
    """Leave the topic with poses out, and take the next one that was found, if there is another."""
    change = _drop_line(draft, ("body",), "pose", why)
    table = change.draft.table(("body",))
    others = [
        row for row, line in enumerate(table.lines)
        if line.key == "pose" and not line.is_active and not line.why.startswith("left out")
    ]  # fmt: skip
    if not others:
        return change
    lines = [*table.lines]
    lines[others[0]] = replace(lines[others[0]], is_active=True, is_guess=True)
    remark = f"{change.remark}; took {lines[others[0]].value}"
    return _Change(change.draft.with_table(replace(table, lines=tuple(lines))), remark)


def _leave_out_culprit(draft: Draft, error: str) -> _Change | None:
    """Leave out what an error names: the poses, boxes or a sensor; `None` where it names nothing that could go."""
    pose = draft.value(("body",), "pose")
    stream = "" if pose is None else str(pose).strip("/")
    if pose is not None and any(f"'{name}'" in error for name in (str(pose), stream)):
        return _next_pose(draft, error)
    for table in ("truth", "results"):
        if f"{table}.topics" in error:
            named = [topic for topic in _topics(draft, table) if f"'{topic}'" in error]
            return _drop_topic(draft, table, named[0] if named else _topics(draft, table)[0], error)
    names = [table.path[1] for table in draft.tables if table.path[0] == "sensors" and table.is_active]
    for name in names:
        if f"'{name}'" in error and len(names) > 1:
            return _Change(draft.without_table(("sensors", name), f"Left out: {error}"), f"left out {name}: {error}")
    return None
