"""Short names of sensors from their topics."""

import re
from collections.abc import Mapping, Sequence

_GENERIC = frozenset(
    ("sensing", "sensor", "sensors", "driver", "drivers", "device", "devices", "perception", "vehicle", "robot", "ros",
     "hardware", "rig", "ego")
)  # fmt: skip
_TAIL = re.compile(
    r"(?:^|_)(image|img|points?|point_?cloud2?|cloud|scans?|detections?|targets?|returns|data|raw|ex|rect|rectified"
    r"|colou?r|mono|gray|bayer|compressed|jpe?g|xyzi?r?t?|converted)$"
)
_KIND_WORDS: Mapping[str, tuple[str, ...]] = {
    "camera": ("cam", "zed", "rgb", "stereo", "fisheye"),
    "lidar": ("lidar", "velo", "ouster", "os0", "os1", "os2", "hesai", "pandar", "livox", "rslidar", "robosense", "vlp",
              "luminar", "innoviz", "laser", "aeva"),
    "radar": ("radar", "ars", "srr", "lrr", "mrr", "umrr", "continental", "smartmicro"),
}  # fmt: skip
_MAX_LENGTH = 40


def stems(topics: Sequence[str]) -> dict[str, str]:
    """Return what is left of each topic without what says nothing about the device: equal for all topics of one."""
    split = {topic: [part for part in topic.split("/") if part] for topic in topics}
    first = {parts[0] for parts in split.values() if parts}
    common = next(iter(first)) if len(first) == 1 and len(split) > 1 else None
    if common is not None and any(not _stem(parts[1:]) for parts in split.values()):
        common = None
    return {topic: _stem(parts[1:] if common is not None else parts) for topic, parts in split.items()}


def _stem(parts: Sequence[str]) -> str:
    plain = [_plain(part) for part in parts]
    name = "_".join(part for part in plain if part and part not in _GENERIC)
    while (shorter := _TAIL.sub("", name)) != name:
        name = shorter
    return _without_repeats(name)


def _plain(text: str) -> str:
    return re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", text.lower())).strip("_")


def _without_repeats(name: str) -> str:
    words = name.split("_")
    return "_".join(word for i, word in enumerate(words) if i == 0 or word != words[i - 1])


def named(kinds: Mapping[str, str], stem_of: Mapping[str, str]) -> dict[str, str]:
    """Return a name for the sensor of each topic: short, unique, the same for the same topics.

    Args:
        kinds: Kind of sensor by topic.
        stem_of: See `stems`.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for topic, kind in sorted(kinds.items()):
        base = _with_kind(stem_of.get(topic, ""), kind)[:_MAX_LENGTH].strip("_")
        name, number = base, 2
        while name in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name)
        found[topic] = name
    return found


def _with_kind(stem: str, kind: str) -> str:
    if any(part.startswith(word) for part in stem.split("_") for word in _KIND_WORDS[kind]):
        return stem
    return f"{kind}_{stem}" if stem else kind
