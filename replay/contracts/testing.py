"""Conformance tests for plug-ins, for their authors; the built-ins pass them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.contracts.importing import FrameRange, ImportRequest, check_items
from fbench.replay.contracts.protocols import Importer
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.logs.container import header_of, header_record
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


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)
