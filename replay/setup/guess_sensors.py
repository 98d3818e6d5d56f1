"""Guesses of sensors: which topics, of what kind, under which names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fbench.replay.data.rig import KINDS, Kind
from fbench.replay.logs.codecs.points import RING_FIELDS
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS
from fbench.replay.setup.inspection import Heard, LeftOut, compensated_field, doppler_field

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


_DERIVED: Mapping[str, tuple[str, ...]] = {
    "lidar": ("map", "cluster", "clusters", "clustered", "ground", "noground", "nonground", "filtered", "filter",
              "concatenated", "concat", "merged", "fused", "combined", "obstacle", "obstacles", "downsampled",
              "downsample", "voxel",
              "voxels", "costmap", "cropped", "segmented", "segmentation", "registered", "accumulated", "global",
              "occupancy", "debug", "objects", "aligned", "submap", "free", "curb", "lanes"),
    "camera": ("depth", "disparity", "mask", "segmentation", "semantic", "debug", "overlay", "annotated",
               "visualization", "heatmap", "confidence", "detections", "result", "results", "thumbnail", "preview"),
    "radar": ("cluster", "clusters", "filtered", "concatenated", "merged", "fused", "combined", "debug", "accumulated",
              "static", "dynamic", "removed"),
}  # fmt: skip
"""Words in topics that something computed from measurements, or that isn't a picture."""
_MAX_NAME = 200
_MAX_FIELDS = 12
_MANY_POINTS, _VERY_MANY_POINTS = 3000, 8000
"""No radar gives so many points a scan with a laser's number, or without one."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A topic that is taken for a sensor."""

    heard: Heard
    name: str
    kind: Kind
    why: str
    is_guess: bool = False

    @property
    def is_own(self) -> bool:
        """Whether fbench wrote it, so that nothing about it is a guess."""
        return self.heard.role.is_own


@dataclass(frozen=True, eq=False)
class Choice:
    """What the topics with measurements are."""

    sensors: tuple[Candidate, ...]  # By name
    left_out: tuple[LeftOut, ...]


def choose(heard: Sequence[Heard]) -> Choice:
    """Choose one topic a device, with its name and kind."""
    topics = [h for h in heard if h.role.kind in KINDS]
    own = [Candidate(h, h.role.sensor, KINDS[h.role.kind], "the log says so") for h in topics if h.role.is_own]
    foreign = [h for h in topics if not h.role.is_own]
    stem_of = stems([h.topic for h in foreign])
    kinds = {h.topic: _kind(h) for h in foreign}
    out: dict[str, str] = {}
    good = _measured(foreign, kinds, out)
    for kind in KINDS.values():
        of_kind = [h for h in good if kinds[h.topic][0] == kind]
        out |= _repeated(kind, of_kind, stem_of)
    chosen = {h.topic: h for h in good if h.topic not in out}
    names = named({topic: kinds[topic][0] for topic in chosen}, stem_of)
    found = [Candidate(h, names[topic], *kinds[topic]) for topic, h in chosen.items()]
    order = sorted([*own, *found], key=lambda c: (list(KINDS).index(c.kind), c.name))
    return Choice(tuple(order), tuple(LeftOut(topic, why) for topic, why in sorted(out.items())))


def _kind(heard: Heard) -> tuple[Kind, str, bool]:
    """Kind, why, and whether it is a guess."""
    kind, field = KINDS[heard.role.kind], doppler_field(heard.fields)
    num = heard.median_points or 0
    if kind == "radar" and field:
        has_rings = any(name.lower() in RING_FIELDS for name in heard.fields)
        if num >= _VERY_MANY_POINTS or (num >= _MANY_POINTS and has_rings):
            return (
                "lidar",
                f"{num} points a message are more than a radar gives, though they have '{field}': FMCW",
                True,
            )
        return "radar", f"its points have a radial velocity, '{field}'", False
    compensated = compensated_field(heard.fields)
    if kind == "lidar" and compensated:
        return "radar", f"its points have '{compensated}', which isn't read: a radar without Doppler", True
    if kind == "lidar" and heard.fields and num < _MANY_POINTS and _is_called_radar(heard):
        fields = ", ".join(heard.fields[:_MAX_FIELDS])
        return "radar", f"it is called so, but none of its fields ({fields}) is known as radial velocity", True
    return kind, f"its type is {heard.schema}", False


def _is_called_radar(heard: Heard) -> bool:
    words = _words(heard.topic) + _words(heard.role.frame_id)
    return any(word.startswith("radar") for word in words) and not any(word.startswith("lidar") for word in words)


def _measured(heard: Iterable[Heard], kinds: Mapping[str, tuple[Kind, str, bool]], out: dict[str, str]) -> list[Heard]:
    """Those that a device measured; of a kind that has only derived topics these, but never in the world's frame."""
    placed = []
    for h in heard:
        if not 0 < len(h.topic) <= _MAX_NAME:
            out[h.topic] = f"its name has {len(h.topic)} characters, at most {_MAX_NAME} are read"
        elif h.role.frame_id.strip("/") in WORLDS:
            out[h.topic] = f"its coordinate frame '{h.role.frame_id}' stands still, so it is a map or moved already"
        else:
            placed.append(h)
    good: list[Heard] = []
    for kind in KINDS.values():
        of_kind = [h for h in placed if kinds[h.topic][0] == kind]
        derived = {h.topic: word for h in of_kind if (word := _derived(kind, h.topic))}
        keep_all = len(derived) == len(of_kind) and kind != "camera"
        for h in of_kind:
            if h.topic in derived and not keep_all:
                out[h.topic] = f"its name says '{derived[h.topic]}': not what the sensor measured"
            else:
                good.append(h)
    return good


def _derived(kind: str, topic: str) -> str:
    return next((word for word in _words(topic) if word in _DERIVED[kind]), "")


def _words(name: str) -> list[str]:
    return name.lower().replace("/", "_").replace("-", "_").split("_")


def _repeated(kind: str, heard: Sequence[Heard], stem_of: Mapping[str, str]) -> dict[str, str]:
    """Topics of a device of which another one is taken, with the reason."""
    out: dict[str, str] = {}
    kept: list[Heard] = []
    most: dict[str, int] = {}
    for h in heard:
        most[stem_of[h.topic]] = max(most.get(stem_of[h.topic], 0), h.num_messages)
    for h in sorted(heard, key=lambda h: _worth(kind, h, most[stem_of[h.topic]])):
        same = next((other for other in kept if _is_same(h, other, stem_of)), None)
        if same is None:
            kept.append(h)
        else:
            out[h.topic] = _why_not(kind, h, same, stem_of)
    return out


def _is_same(a: Heard, b: Heard, stem_of: Mapping[str, str]) -> bool:
    if stem_of[a.topic] == stem_of[b.topic]:
        return True
    frame = a.role.frame_id
    return bool(frame) and frame == b.role.frame_id and frame.strip("/") not in BODIES


def _worth(kind: str, h: Heard, most: int) -> tuple[object, ...]:
    """Sorts the best topic of a device first. Images as they came from the camera fit K and its distortion; raw ones
    have no artefacts, but recorders drop some of what is large; `most` messages are those of its fullest topic.
    """
    topic, is_thin = h.topic.lower(), h.num_messages < 0.9 * most
    if kind == "camera":
        return "rect" in topic, is_thin, "mono" in topic or "gray" in topic, "compressed" in topic, h.topic
    return _derived(kind, topic) != "", not doppler_field(h.fields), -(h.median_points or 0), is_thin, h.topic


def _why_not(kind: str, h: Heard, better: Heard, stem_of: Mapping[str, str]) -> str:
    if stem_of[h.topic] != stem_of[better.topic]:
        return f"in the same coordinate frame as {better.topic}, '{h.role.frame_id}', so one device; one is taken"
    if kind == "camera" and "rect" in h.topic.lower() and "rect" not in better.topic.lower():
        return f"the same camera as {better.topic}, rectified; K and distortion are for images that aren't"
    if kind == "camera" and "compressed" in h.topic.lower():
        return f"the same camera as {better.topic}, which has no artefacts of compression"
    if h.num_messages < 0.9 * better.num_messages:
        return (
            f"the same device as {better.topic}, which has more messages: {better.num_messages}, not {h.num_messages}"
        )
    return f"the same device as {better.topic}"
