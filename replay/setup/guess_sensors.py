"""Guesses of sensors: which topics, of what kind, under which names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count, groupby

from fbench.replay.data.rig import KINDS, Kind
from fbench.replay.logs.codecs.packed_points import DOPPLER_FIELDS, RING_FIELDS, VECTOR_FIELDS
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS
from fbench.replay.setup.inspection import LeftOut, SampledTopic

_GENERIC = frozenset(
    ("sensing", "sensor", "sensors", "driver", "drivers", "device", "devices", "perception", "vehicle", "robot", "ros",
     "hardware", "rig", "ego")
)  # fmt: skip
_TAIL = re.compile(
    r"(?:^|_)(image|img|packets?|points?|point_?cloud2?|cloud|scans?|detections?|targets?|returns|data|raw|ex|rect|rectified"
    r"|colou?r|mono|gray|bayer|compressed|jpe?g|xyzi?r?t?|converted)$"
)
_KIND_WORDS: Mapping[str, tuple[str, ...]] = {
    "camera": ("cam", "zed", "rgb", "stereo", "fisheye"),
    "lidar": ("lidar", "velo", "ouster", "os0", "os1", "os2", "hesai", "pandar", "livox", "rslidar", "robosense", "vlp",
              "luminar", "innoviz", "laser", "aeva"),
    "radar": ("radar", "ars", "srr", "lrr", "mrr", "umrr", "continental", "smartmicro"),
}  # fmt: skip
_MAX_LENGTH = 40


def find_stems(topics: Sequence[str]) -> dict[str, str]:
    """Return what is left of each topic without what says nothing about the device: equal for all topics of one."""
    split = {topic: [part for part in topic.split("/") if part] for topic in topics}
    first = {parts[0] for parts in split.values() if parts}
    has_common = len(first) == 1 and len(split) > 1 and all(_stem(parts[1:]) for parts in split.values())
    return {topic: _stem(parts[1:] if has_common else parts) for topic, parts in split.items()}


def _stem(parts: Sequence[str]) -> str:
    plain = [re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", part.lower())).strip("_") for part in parts]
    name = "_".join(part for part in plain if part and part not in _GENERIC)
    while (shorter := _TAIL.sub("", name)) != name:
        name = shorter
    return "_".join(word for word, _ in groupby(name.split("_")))


def name_sensors(kinds: Mapping[str, str], stems: Mapping[str, str]) -> dict[str, str]:
    """Name the sensor of each topic: short, unique, always the same; `kinds` are by topic, `stems` of `find_stems`."""
    found: dict[str, str] = {}
    for topic, kind in sorted(kinds.items()):
        stem = stems.get(topic, "")
        if not any(part.startswith(word) for part in stem.split("_") for word in _KIND_WORDS[kind]):
            stem = f"{kind}_{stem}" if stem else kind
        base = stem[:_MAX_LENGTH].strip("_")
        options = chain([base], (f"{base}_{number}" for number in count(2)))
        found[topic] = next(name for name in options if name not in found.values())
    return found


_DERIVED: Mapping[str, tuple[str, ...]] = {
    "lidar": ("map", "cluster", "clusters", "clustered", "ground", "noground", "nonground", "filtered", "filter",
              "concatenated", "concat", "merged", "fused", "combined", "obstacle", "obstacles", "downsampled",
              "downsample", "voxel", "voxels", "costmap", "cropped", "segmented", "segmentation", "registered",
              "accumulated", "global", "occupancy", "debug", "objects", "aligned", "submap", "free", "curb", "lanes"),
    "camera": ("depth", "disparity", "mask", "segmentation", "semantic", "debug", "overlay", "annotated",
               "visualization", "heatmap", "confidence", "detections", "result", "results", "thumbnail", "preview"),
    "radar": ("cluster", "clusters", "filtered", "concatenated", "merged", "fused", "combined", "debug", "accumulated",
              "static", "dynamic", "removed"),
}  # fmt: skip
"""Words in topics that something computed from measurements, or that isn't a picture."""
_CLOUDS = ("PointCloud2", "foxglove.PointCloud", "RadarScan")
"""Types of messages that also hold points which something computed."""
_COMPENSATED = ("comp", "compensated", "corrected", "ego")
_SPEEDS = ("v", "vr", "vx", "doppler", "velocity", "speed", "radial")
"""Words of fields with velocities that are free of the vehicle's own motion, which fbench doesn't read."""
_MAX_NAME = 200
_MAX_FIELDS = 12
_MANY_POINTS, _VERY_MANY_POINTS = 3000, 8000
"""No radar gives so many points a scan with a laser's number, or without one."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A topic that is taken for a sensor."""

    sampled: SampledTopic
    name: str
    kind: Kind
    why: str
    is_guess: bool = False

    @property
    def is_own(self) -> bool:
        """Whether fbench wrote it, so that nothing about it is a guess."""
        return self.sampled.role.is_own


def choose_sensors(topics: Sequence[SampledTopic]) -> tuple[tuple[Candidate, ...], tuple[LeftOut, ...]]:
    """Choose one topic a device, with its name and kind: sensors by kind and name, and what is left out."""
    topics = [t for t in topics if t.role.kind in KINDS]
    sensors = [Candidate(t, t.role.sensor, KINDS[t.role.kind], "the log says so") for t in topics if t.role.is_own]
    foreign = [t for t in topics if not t.role.is_own]
    stems = find_stems([t.topic for t in foreign])
    kinds = {t.topic: _guess_kind(t) for t in foreign}
    out: dict[str, str] = {}
    good = _drop_derived(foreign, kinds, out)
    for kind in KINDS.values():
        _drop_repeated(kind, [t for t in good if kinds[t.topic][0] == kind], stems, out)
    chosen = {t.topic: t for t in good if t.topic not in out}
    names = name_sensors({topic: kinds[topic][0] for topic in chosen}, stems)
    sensors += [Candidate(t, names[topic], *kinds[topic]) for topic, t in chosen.items()]
    sensors.sort(key=lambda c: (list(KINDS).index(c.kind), c.name))
    return tuple(sensors), tuple(LeftOut(topic, why) for topic, why in sorted(out.items()))


def _guess_kind(topic: SampledTopic) -> tuple[Kind, str, bool]:
    kind, field = KINDS[topic.role.kind], _doppler_field(topic.fields)
    num = topic.median_points or 0
    if kind == "radar" and field:
        has_rings = any(name.lower() in RING_FIELDS for name in topic.fields)
        if num >= _VERY_MANY_POINTS or (num >= _MANY_POINTS and has_rings):
            why = f"{num} points per message are too many for a radar, although they have '{field}': FMCW"
            return "lidar", why, True
        return "radar", f"its points have a radial velocity, '{field}'", False
    if kind == "lidar":
        for name in topic.fields:
            parts = name.lower().split("_")
            if any(part in _COMPENSATED for part in parts) and any(part in _SPEEDS for part in parts):
                return "radar", f"its points have '{name}', which fbench doesn't read: a radar without Doppler", True
        words = _words(topic.topic) + _words(topic.role.frame_id)
        is_called_radar, is_called_lidar = (any(w.startswith(k) for w in words) for k in ("radar", "lidar"))
        if topic.fields and num < _MANY_POINTS and is_called_radar and not is_called_lidar:
            fields = ", ".join(topic.fields[:_MAX_FIELDS])
            return "radar", f"by its name, but none of its fields ({fields}) is a known radial velocity", True
    return kind, f"its type is {topic.schema}", False


def _doppler_field(fields: tuple[str, ...]) -> str:
    """The field with the radial velocity that fbench reads, empty where none has it."""
    lower = {name.lower(): name for name in fields}
    found = next((lower[name] for name in DOPPLER_FIELDS if name in lower), "")
    if not found and all(name in lower for name in VECTOR_FIELDS):
        return " and ".join(lower[name] for name in VECTOR_FIELDS)
    return found


def _drop_derived(
    topics: Iterable[SampledTopic], kinds: Mapping[str, tuple[Kind, str, bool]], out: dict[str, str]
) -> list[SampledTopic]:
    """Those that a device measured; of a kind that has only derived topics these, but never in the world's frame."""
    by_kind: dict[str, list[SampledTopic]] = {kind: [] for kind in KINDS.values()}
    for t in topics:
        if not 0 < len(t.topic) <= _MAX_NAME:
            out[t.topic] = f"its name has {len(t.topic)} characters, at most {_MAX_NAME} are read"
        elif (frame := t.role.frame_id).strip("/") in WORLDS:
            out[t.topic] = f"its coordinate frame '{frame}' is stationary, so it holds a map or points already moved"
        else:
            by_kind[kinds[t.topic][0]].append(t)
    good = []
    for kind, of_kind in by_kind.items():
        derived = {t.topic: word for t in of_kind if (word := _derivation_word(kind, t))}
        if len(derived) == len(of_kind) and kind != "camera":
            derived = {}
        why = "its name contains '{}', so it doesn't hold raw measurements"
        out |= {topic: why.format(word) for topic, word in derived.items()}
        good += [t for t in of_kind if t.topic not in derived]
    return good


def _derivation_word(kind: str, topic: SampledTopic) -> str:
    """A word that says that something computed the points of a cloud; lists of clusters are what a radar gives."""
    if kind == "radar" and topic.schema.rpartition("/")[2] not in _CLOUDS:
        return ""
    return next((word for word in _words(topic.topic) if word in _DERIVED[kind]), "")


def _words(name: str) -> list[str]:
    return re.split("[_/-]", name.lower())


def _drop_repeated(kind: str, topics: Sequence[SampledTopic], stems: Mapping[str, str], out: dict[str, str]) -> None:
    """Add to `out` the topics of a device of which another one is taken, with the reason."""
    most: dict[str, int] = {}
    for t in topics:
        most[stems[t.topic]] = max(most.get(stems[t.topic], 0), t.num_messages)

    def rank(t: SampledTopic) -> tuple[object, ...]:
        """Sorts the best topic of a device first."""
        topic, is_thin = t.topic.lower(), t.num_messages < 0.9 * most[stems[t.topic]]
        if kind == "camera":
            # As they came from the camera they fit K; raw ones have no artifacts, but recorders drop what is large.
            return "rect" in topic, is_thin, "mono" in topic or "gray" in topic, "compressed" in topic, t.topic
        no_doppler = not _doppler_field(t.fields)
        return (
            t.role.same_as != "",
            _derivation_word(kind, t) != "",
            no_doppler,
            -(t.median_points or 0),
            is_thin,
            t.topic,
        )

    kept: list[SampledTopic] = []
    for t in sorted(topics, key=rank):
        stem, frame = stems[t.topic], t.role.frame_id
        own_frame = frame if frame.strip("/") not in BODIES else ""
        same = [o for o in kept if stems[o.topic] == stem or (own_frame and o.role.frame_id == own_frame)]
        same = same or [o for o in kept if o.topic == t.role.same_as]
        if same:
            out[t.topic] = _why_not(kind, t, same[0], stems)
        else:
            kept.append(t)


def _why_not(kind: str, t: SampledTopic, better: SampledTopic, stems: Mapping[str, str]) -> str:
    if better.topic == t.role.same_as:
        return f"another form of what {better.topic} holds"
    if stems[t.topic] != stems[better.topic]:
        return f"in the same coordinate frame as {better.topic}, '{t.role.frame_id}', so one device: only one is used"
    if kind == "camera" and "rect" in t.topic.lower() and "rect" not in better.topic.lower():
        return f"the same camera as {better.topic}, rectified, but K and distortion are for the original images"
    if kind == "camera" and "compressed" in t.topic.lower():
        return f"the same camera as {better.topic}, which is uncompressed"
    why = f"the same device as {better.topic}"
    if t.num_messages < 0.9 * better.num_messages:
        why += f", which has more messages: {better.num_messages}, not {t.num_messages}"
    return why
