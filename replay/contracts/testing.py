"""Conformance tests for plug-ins, for their authors; the built-ins pass them."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from fbench.replay.contracts.decoders import Decoder
from fbench.replay.contracts.errors import DecodeError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest, check_items
from fbench.replay.contracts.protocols import Importer
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
