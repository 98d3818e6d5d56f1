"""Conformance tests for plug-ins, for their authors; the built-ins pass them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.steps import find_wrong, times_of
from fbench.replay.contracts.conditions import (
    NUM_LEVELS,
    ChangesTimes,
    Condition,
    DisturbsRig,
    Level,
    Measurement,
    require_levels,
)
from fbench.replay.contracts.decoders import Decoder
from fbench.replay.contracts.errors import DecodeError, FbenchError, one_line
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest, check_items
from fbench.replay.contracts.protocols import Importer
from fbench.replay.contracts.street import Call, Street, list_calls
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.logs.codecs.codec import NothingError, Origin
from fbench.replay.logs.codecs.plugin import PluginCodec
from fbench.replay.logs.container import Channel, Entry, header_of, header_record
from fbench.replay.logs.open import open_container
from fbench.replay.logs.roles import STORED
from fbench.replay.runs.digest import Digest, digest


@dataclass(frozen=True)
class _Seen:
    header: dict[str, str]
    rig: str
    digest: str
    num: int
    num_announced: int
    numbers: frozenset[int]  # Of frames
    lines: tuple[str, ...]


def check_importer(make: Callable[[], Importer], source: Path, max_recordings: int = 3) -> None:
    """See that an importer keeps what its protocol promises, on the folder `source`.

    Its names are stable; it gives the wanted sequences in their order; rig, info and the number of items are there
    before the items, which are in the order of `log_ns` and come from sensors of the rig; a second importer gives the
    same; a range of frames gives those alone, under another id; the summary says something.

    Args:
        make: Makes an importer; called several times.
        source: A folder of the dataset.
        max_recordings: Only so many sequences are read.

    Raises:
        AssertionError: saying what it doesn't keep.
        LogError: naming what is wrong with the folder, or an item that no log can hold.
    """
    names = list(make().names(source))
    _require(bool(names), "names() finds no sequence")
    _require(len(set(names)) == len(names), f"names() gives one twice: {names}")
    _require(list(make().names(source)) == names, "names() gives other names the second time")
    wanted = tuple(names[:max_recordings])
    first, second = (_read(make(), source, ImportRequest(wanted)) for _ in range(2))
    for found in (first, second):
        _require(tuple(found) == wanted, f"recordings() gives {list(found)}, wanted were {list(wanted)}")
    for name, seen in first.items():
        _require(bool(seen.lines), f"{name}: summary() says nothing")
        bad = [line for line in seen.lines if not line or not line.isprintable()]
        _require(not bad, f"{name}: summary() has lines that aren't one printable line each: {bad}")
        near = seen.num / 2 - 10 <= seen.num_announced <= seen.num * 2 + 10
        _require(near, f"{name}: num_items says {seen.num_announced}, there are {seen.num}")
        for key in ("metadata.dataset", "metadata.licence"):
            _require(key in seen.header, f"{name}: info lacks {key}")
        _require(seen == second[name], f"{name}: is another the second time")
    ids = [seen.header["log_id"] for seen in first.values()]
    _require(len(set(ids)) == len(ids), f"sequences have the same id: {ids}")
    for name, whole in first.items():
        if len(whole.numbers) > 1:
            numbers = sorted(whole.numbers)
            frames = FrameRange(numbers[0], numbers[len(numbers) // 2])
            found = _read(make(), source, ImportRequest((name,), frames))
            _require(tuple(found) == (name,), f"recordings() gives {list(found)}, wanted was {name}")
            outside = sorted(number for number in found[name].numbers if number not in frames)
            _require(not outside, f"{name}: gives frames {outside[:5]} where {frames} are wanted")
            is_other = found[name].header["log_id"] != whole.header["log_id"]
            _require(is_other, f"{name}: has the same id where other frames are wanted")


def _read(importer: Importer, source: Path, request: ImportRequest) -> dict[str, _Seen]:
    found: dict[str, _Seen] = {}
    for recording in importer.recordings(source, request):
        rig, info, num_announced = recording.rig, recording.info, recording.num_items
        cameras = {sensor for sensor, mount in rig.mounts.items() if mount.kind == "camera"}
        _require(
            set(rig.cameras) == cameras, f"{recording.name}: the rig's cameras and its mounts of kind camera differ"
        )
        items, num, numbers = Digest(), 0, set[int]()
        for item in check_items(recording.name, rig, recording.items()):
            items.add(item)
            num += 1
            if isinstance(item, Image | PointCloud | RadarScan | Truth) and item.frame_number is not None:
                numbers.add(item.frame_number)
        header, lines = header_record(header_of(info, rig)), tuple(recording.summary())
        seen = _Seen(header, digest(rig), items.hex(), num, num_announced, frozenset(numbers), lines)
        found[recording.name] = seen
    return found


def check_decoder(decoder: Decoder, log: Path, max_messages: int = 100) -> int:
    """See that a decoder keeps what its protocol promises, on the first messages of a log that it is for.

    It decodes all of them, and not each to nothing; results are of its kind, and the sensor of a topic is always the
    same; in another order, the same messages give the same results.

    Args:
        decoder: What `@decodes` made.
        log: Any log that fbench opens.
        max_messages: Only so many of each topic are decoded.

    Returns:
        How many messages gave something.

    Raises:
        AssertionError: saying what it doesn't keep.
        LogError: where the log can't be read.
    """
    container, num = open_container(log, FaultLog()), 0
    ids = [id_ for id_, channel in sorted(container.channels.items()) if _fits(decoder, channel)]
    _require(bool(ids), f"{log}: no topic is of a type that the decoder names")
    for id_ in ids:
        entries = list(islice(container.entries(frozenset([id_])), max_messages))
        first = [_decode(PluginCodec("checked", decoder, container.channels[id_]), entry) for entry in entries]
        codec = PluginCodec("checked", decoder, container.channels[id_])
        again = [_decode(codec, entry) for entry in reversed(entries)][::-1]
        for entry, one, other in zip(entries, first, again, strict=True):
            where = f"{entry.topic} at {entry.log_ns}"
            _require(one == other, f"{where}: gives another result where other messages come before it")
        sensors = sorted({found.sensor for found in first if found is not None})
        _require(len(sensors) <= 1, f"{container.channels[id_].topic}: gives several sensors: {', '.join(sensors)}")
        num += sum(found is not None for found in first)
    _require(num > 0, f"{log}: every message gives None")
    return num


def check_condition(make: Callable[[], Condition], num_messages: int = 12) -> None:
    """See that a condition keeps what its protocol promises, at all severities, on a street in memory.

    It gives messages of the same type and sensor, finite, none delivered early; without `changes_times = True` one
    each, with the same times. It changes something at every severity, on average more at higher ones, and never its
    input. What becomes of a message depends on no other one, and on no instance of the condition.

    Args:
        make: Makes a condition; called several times.
        num_messages: So many messages of each sensor are disturbed.

    Raises:
        AssertionError: saying what it doesn't keep.
        ConfigError: where its levels aren't five numbers each.
    """
    require_levels("checked", make())
    street = Street(num_messages)
    found = [_measure_severity(make, street, severity) for severity in range(1, NUM_LEVELS + 1)]
    by_kind = {kind: [amounts[kind] for amounts in found] for kind in found[0]}
    by_kind = {kind: rows for kind, rows in by_kind.items() if any(any(row.values()) for row in rows)}
    _require(bool(by_kind), "changes nothing at any severity")
    for kind, rows in by_kind.items():
        empty = [str(severity) for severity, row in enumerate(rows, 1) if not any(row.values())]
        _require(not empty, f"changes nothing of a {kind} at severity {', '.join(empty)}")
        series = {name: [row[name] for row in rows] for name in rows[0]}
        is_even = all(np.allclose(values, values[0], rtol=_NOISE) for values in series.values())
        is_growing = any(
            values[-1] > values[0] and all(b >= a - _NOISE * max(values) for a, b in pairwise(values))
            for values in series.values()
        )
        _require(is_even or is_growing, f"changes no more of a {kind} at higher severities: {series}")


_NOISE = 0.05  # Of the largest mean over few messages: so much one may be below that of the severity before
_NUM_SEEDS = 64  # For what is drawn once a log or once a message


def _measure_severity(make: Callable[[], Condition], street: Street, severity: int) -> dict[str, dict[str, float]]:
    """How much a condition changes on average, by kind of sensor. Raises AssertionError where it breaks its promise."""
    first, second = make(), make()
    level = {name: float(values[severity - 1]) for name, values in first.levels.items()}
    may_change_times = isinstance(first, ChangesTimes) and first.changes_times
    amounts: dict[str, list[dict[str, float]]] = {}
    inputs = digest([*street.messages(), *street.truths()])
    calls = list_calls(first, street, severity)
    results = [_call(first, call, level) for call in calls]
    order = generator(severity, "order").permutation(len(calls))
    again = {int(num): digest(list(_call(second, calls[num], level))) for num in order}
    for num, (call, found) in enumerate(zip(calls, results, strict=True)):
        where = f"severity {severity}, {call.message.sensor} at {call.message.stamp_ns}"
        for result in found:
            _require(not (wrong := find_wrong(call.message, result)), f"{where}: {wrong}")
            _require(_is_finite(result), f"{where}: gives numbers that aren't finite")
        is_same = times_of(found) == times_of([call.message])
        _require(may_change_times or is_same, f"{where}: changes times, but doesn't say changes_times = True")
        _require(digest(list(found)) == again[num], f"{where}: gives another result after other messages")
        amounts.setdefault(call.site.kind, []).append(_measure(call.message, found))
    for seed in range(1, _NUM_SEEDS if may_change_times else 1):
        for call in (call.with_seed(seed) for call in calls):
            amounts[call.site.kind].append(_measure(call.message, _call(first, call, level)))
    is_same = inputs == digest([*street.messages(), *street.truths()])
    _require(is_same, f"severity {severity}: changes its input")
    if isinstance(first, DisturbsRig) and isinstance(second, DisturbsRig):
        for sensor, site in {call.message.sensor: call.site for call in calls}.items():
            given = first.disturb_rig(street.rig, level, site)
            is_same = digest(given) == digest(second.disturb_rig(street.rig, level, site))
            _require(is_same, f"severity {severity}: gives another rig the second time")
            effects = Effects()
            effects.add_rig(street.rig, given)
            amounts[site.kind] = [effects.rows().get(sensor, {})]
    return {
        kind: {name: float(np.mean([row[name] for row in rows])) for name in rows[0]} for kind, rows in amounts.items()
    }


def _call(condition: Condition, call: Call, level: Level) -> tuple[Measurement, ...]:
    try:
        return call.disturb(condition, level)
    except FbenchError:
        raise
    except Exception as error:
        raise AssertionError(f"{call.message.sensor} at {call.message.stamp_ns}: fails: {one_line(error)}") from error


def _is_finite(message: Measurement) -> bool:
    arrays = (value for f in fields(message) if isinstance(value := getattr(message, f.name), np.ndarray))
    return all(np.isfinite(array).all() for array in arrays)


def _measure(message: Measurement, results: Sequence[Measurement]) -> dict[str, float]:
    """What became of one message, in numbers of which the larger one is the larger change."""
    first = results[0] if results else message
    amounts = {
        "dropped": float(not results), "added": float(max(0, len(results) - 1)),
        "late_ns": float(sum(result.log_ns - message.log_ns for result in results)),
        "restamped_ns": float(abs(first.stamp_ns - message.stamp_ns)),
    }  # fmt: skip
    if isinstance(message, Image) or isinstance(first, Image):
        if getattr(first, "data", None) is getattr(message, "data", None):
            return {**amounts, "gray_levels": 0.0, "squared": 0.0}
        old, new = (decode(image) if isinstance(image, Image) else None for image in (message, first))
        difference = np.zeros(1) if old is None or new is None else old.astype(np.float64) - new
        return {**amounts, "gray_levels": float(np.abs(difference).mean()), "squared": float((difference**2).mean())}
    if np.array_equal(_rows(message), _rows(first)):
        return amounts | dict.fromkeys(("gone", "new", "fewer", "moved_m", "values", "total"), 0.0)
    old_rows, new_rows = ({row.tobytes() for row in _rows(points)} for points in (message, first))
    amounts |= {"gone": float(len(old_rows - new_rows)), "new": float(len(new_rows - old_rows))}
    amounts |= {"fewer": float(max(0, len(message.xyz) - len(first.xyz))), "moved_m": 0.0, "values": 0.0}
    amounts["total"] = float(np.abs(_rows(first)[:, 3:].sum(axis=0) - _rows(message)[:, 3:].sum(axis=0)).sum())
    if len(message.xyz) == len(first.xyz):
        change = np.abs(_rows(first) - _rows(message))
        amounts |= {"moved_m": float(change[:, :3].sum()), "values": float(change[:, 3:].sum())}
    return amounts


def _rows(points: PointCloud | RadarScan) -> Float64:
    """Coordinates of points beside their other values."""
    names = ("intensity",) if isinstance(points, PointCloud) else ("radial_velocity_mps", "rcs_dbsm")
    values = [getattr(points, name) for name in names]
    return np.column_stack([points.xyz, *(value for value in values if value is not None)]).astype(np.float64)


class _Result(NamedTuple):
    sensor: str
    digest: str


def _fits(decoder: Decoder, channel: Channel) -> bool:
    return channel.encoding != STORED and decoder.fits(channel.topic, channel.schema_name)


def _decode(codec: PluginCodec, entry: Entry) -> _Result | None:
    """What a message gives, `None` for nothing. Raises AssertionError where it can't be decoded."""
    if not isinstance(entry.data, memoryview):
        raise AssertionError(f"{entry.topic}: holds no payloads")  # noqa: TRY004
    kind, origin = codec.kinds[0], Origin("", entry.log_ns, entry.publish_ns)
    try:
        if kind == "truth":
            part = codec.truth(entry.data, origin)
            return _Result("", f"{part.frame_id} {digest(part.truth)}")
        return _Result(codec.probe_at(entry.data, origin).frame_id, digest(codec.message(kind, entry.data, origin)))
    except NothingError:
        return None
    except DecodeError as error:
        raise AssertionError(f"{entry.topic} at {entry.log_ns}: {error}") from error


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)
