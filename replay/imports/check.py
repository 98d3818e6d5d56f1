"""What importers give, seen to before it is stored."""

from collections.abc import Iterable, Iterator
from typing import get_args

from fbench.replay.data import Image, Kind, Message, PointCloud, Pose, RadarScan, Rig, RigChange, Truth
from fbench.replay.errors import LogError
from fbench.replay.imports.imported import Imported, OtherResult

_MAX_NS = 2**63 - 1
_KINDS: dict[type[Message], Kind] = {Image: "camera", PointCloud: "lidar", RadarScan: "radar"}


def checked_items(name: str, rig: Rig, items: Iterable[Imported]) -> Iterator[Imported]:
    """Pass on the items of the sequence `name`, at least one, which fit the rig and are in the order of `log_ns`.

    Raises:
        LogError: for the first item that doesn't, or where there is none.
    """
    last_ns = -1
    for item in items:
        if not isinstance(item, get_args(Imported)):
            raise LogError(f"{name}: its importer gives {type(item).__name__}, which no log can hold")
        log_ns, stamp_ns = times_ns(item)
        if not (0 <= log_ns <= _MAX_NS and 0 <= stamp_ns <= _MAX_NS):
            raise LogError(f"{name}: {_what(item)} at {stamp_ns} ns, recorded at {log_ns}: outside 0 to 2^63 - 1")
        if log_ns < last_ns:
            raise LogError(f"{name}: its importer gives {_what(item)} of {log_ns} ns after something of {last_ns}")
        last_ns = log_ns
        rig = item.rig if isinstance(item, RigChange) else rig
        _check_sensor(name, item, rig)
        yield item
    if last_ns < 0:
        raise LogError(f"{name}: nothing in it to import, are --frames outside of it?")


def times_ns(item: Imported) -> tuple[int, int]:
    """When an item was recorded, and when it was measured."""
    match item:
        case RigChange():
            return item.log_ns, item.log_ns
        case OtherResult():
            return item.boxes.log_ns, item.boxes.stamp_ns
        case _:
            return item.log_ns, item.stamp_ns


def _check_sensor(name: str, item: Imported, rig: Rig) -> None:
    if isinstance(item, Image | PointCloud | RadarScan):
        kind = _KINDS[type(item)]
        mount = rig.mounts.get(item.sensor)
        if mount is None or mount.kind != kind:
            raise LogError(f"{name}: {_what(item)} comes from a {kind} that the rig lacks")


def _what(item: Imported) -> str:
    match item:
        case Image() | PointCloud() | RadarScan() | Pose():
            return f"{type(item).__name__} of '{item.sensor}'"
        case Truth() | OtherResult() | RigChange():
            return type(item).__name__
    return "an item"
