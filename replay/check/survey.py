"""Survey of a log from its index where it has one; all times are those at which messages were recorded."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.messages import BOXES
from fbench.replay.data.rig import LogInfo, RigChange
from fbench.replay.engine.frame_buffer import SyncParams, choose_reference
from fbench.replay.logs.codecs.codec import MESSAGES
from fbench.replay.logs.open import Storage, read_log_times, span_ns, storage
from fbench.replay.logs.partial_rig import PartialRig, partial_rig
from fbench.replay.logs.reader import LogReader

_MAX_RIG_MESSAGES = 2000  # Transforms and calibrations are read for changes of the rig, where there are no more of them
_NO_TIMES: Int64 = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Topic:
    """One topic, whether fbench has a use for it or not."""

    topic: str
    schema: str
    encoding: str
    kind: str  # `camera`, `lidar`, `radar`, `pose`, `calibration`, `transform`, `truth`, `detections`; empty: unused
    num_messages: int


@dataclass(frozen=True)
class Stream:
    """The messages of one sensor, or of poses."""

    sensor: str
    kind: str
    num_messages: int
    first_log_ns: int | None  # `None` where the index doesn't tell, or without messages; so are the others
    last_log_ns: int | None
    median_period_ns: int | None
    rate_hz: float | None  # From the median period, else from number and duration
    is_estimate: bool = False  # Whether a sample says how many messages a measurement of it has


@dataclass(frozen=True)
class Survey:
    """What a log holds."""

    info: LogInfo
    storage: Storage
    known: PartialRig
    reference: str | None  # `None` where no sensor has messages
    streams: tuple[Stream, ...]
    topics: tuple[Topic, ...]
    num_truths: int  # Messages of ground truth
    span_ns: tuple[int, int] | None  # Log times of the first and the last message but those of the rig
    breaks: tuple[str, ...] | None
    """Why new segments begin: the reference sensor pauses, or the rig changes; `None`: not known without reading."""
    rig_changes: tuple[RigChange, ...] | None  # `None`: not known without reading
    num_frames: int  # Messages of the reference sensor, or instants of boxes


def survey(reader: LogReader, params: SyncParams) -> Survey:
    """Survey a log; one without an index is read once, without decoding it. Raises LogError where it can't be read."""
    container = reader.container
    by_channel = container.log_times()
    form, known = storage(container, by_channel), partial_rig(reader)
    if by_channel is None and not form.is_indexed:
        by_channel = read_log_times(container)
    span = span_ns(container, by_channel)
    if by_channel is not None:  # what was cut out of a log has the rig of before, with its times
        known_kinds = {id_: role.kind for id_, role in reader.roles.items()}
        measured = {i: t for i, t in by_channel.items() if known_kinds.get(i) not in ("transform", "calibration")}
        span = span_ns(container, measured) or span
    reference = reference_of(reader, known, params)
    times: dict[str, Int64] = {}
    for id_, role in sorted(reader.roles.items()):
        if by_channel is not None and role.kind in MESSAGES:
            parts = [times.get(role.sensor, _NO_TIMES), by_channel.get(id_, _NO_TIMES)]
            times[role.sensor] = np.sort(np.concatenate(parts), kind="stable")
    for name in sorted(reader.parts.keys() & times.keys()):
        times[name] = times[name][:: round(reader.parts[name])]  # of measurements
    changes = reader.rig_changes(_MAX_RIG_MESSAGES)
    breaks = None if by_channel is None else _find_breaks(times.get(reference or "", _NO_TIMES), changes or (), params)
    kinds: dict[str, str] = {**dict.fromkeys(reader.poses, "pose"), **known.kinds}
    streams = []
    for name in sorted(kinds):
        if by_channel is not None:
            stream = _describe_stream(name, kinds[name], times.get(name, _NO_TIMES))
            streams.append(replace(stream, num_messages=reader.num_messages[name]) if name in reader.parts else stream)
        else:
            num = reader.num_messages.get(name, 0)
            streams.append(Stream(name, kinds[name], num, None, None, None, _mean_rate(num, span)))
        streams[-1] = replace(streams[-1], is_estimate=name in reader.estimated)
    num_frames = next((s.num_messages for s in streams if s.sensor == reference), 0)
    if reference == BOXES:
        num_frames = reader.num_messages.get(BOXES, 0)
    return Survey(
        reader.info, form, known, reference, tuple(streams), topics_of(reader),
        sum(container.counts.get(id_, 0) for id_, role in reader.roles.items() if role.kind == "truth"), span,
        breaks, None if changes is None else tuple(changes), num_frames,
    )  # fmt: skip


def _find_breaks(log_ns: Int64, changes: Sequence[RigChange], params: SyncParams) -> tuple[str, ...]:
    """Say why new segments begin, by the times (N,) of the reference sensor: where both are, the rig is the reason."""
    steps = np.diff(log_ns)
    why = {int(i) + 1: f"gap of {steps[i] / 1e9:.3f} s" for i in np.flatnonzero(steps > params.max_gap_ns)}
    for change in changes:
        frame = int(np.searchsorted(log_ns, change.log_ns))
        if 0 < frame < len(log_ns):
            why[frame] = change.reason
    return tuple(f"{why[frame]} before frame {frame}" for frame in sorted(why))


def _describe_stream(sensor: str, kind: str, log_ns: Int64) -> Stream:
    if len(log_ns) == 0:
        return Stream(sensor, kind, 0, None, None, None, None)
    first, last = int(log_ns[0]), int(log_ns[-1])
    steps = np.sort(np.diff(log_ns), kind="stable")
    period = int(steps[len(steps) // 2]) if len(steps) else None
    rate = 1e9 / period if period else _mean_rate(len(log_ns), (first, last))
    return Stream(sensor, kind, len(log_ns), first, last, period, rate)


def _mean_rate(num: int, span: tuple[int, int] | None) -> float | None:
    duration_ns = 0 if span is None else span[1] - span[0]
    return (num - 1) * 1e9 / duration_ns if num > 1 and duration_ns else None


def reference_of(reader: LogReader, known: PartialRig, params: SyncParams) -> str | None:
    """Return the reference sensor, even of an incomplete rig, or `None`. Raises ConfigError where the log lacks it."""
    try:
        return choose_reference(known.kinds, reader.info, reader.num_messages, params)
    except LogError:
        return None
    except ConfigError:
        if params.reference is not None:
            raise
        return None  # what the log's metadata name isn't there


def topics_of(reader: LogReader) -> tuple[Topic, ...]:
    """All topics of a log, by name, over all parts of the recording."""
    container = reader.container
    nums: Counter[tuple[str, str, str, str]] = Counter()
    for id_, c in sorted(container.channels.items(), key=lambda item: (item[1].topic, item[0])):
        kind = reader.roles[id_].kind if id_ in reader.roles else ""
        nums[c.topic, c.schema_name, c.encoding, kind] += container.counts.get(id_, 0)
    return tuple(Topic(*key, num) for key, num in nums.items())
