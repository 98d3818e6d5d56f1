"""Roles of channels: kind, sensor, and where frame numbers are; selection by patterns."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice

from fbench.replay.contracts.errors import (
    ConfigError,
    DecodeError,
    DepthError,
    LogError,
    UnsupportedError,
    did_you_mean,
)
from fbench.replay.contracts.faults import UNREAD, UNREAD_SENSOR
from fbench.replay.data.messages import Image, Message
from fbench.replay.data.video import CODECS
from fbench.replay.logs.codecs.codec import MESSAGES, SENSORS, Codec, NothingError, Origin, Probe
from fbench.replay.logs.codecs.foxglove.topics import FRAME_NUMBER, KIND, SENSOR, SEQUENCE, SIZE
from fbench.replay.logs.codecs.plugin import NamedDecoder, PluginCodec
from fbench.replay.logs.codecs.video.stream import OrderProbe
from fbench.replay.logs.container import Channel, Container, Schema
from fbench.replay.logs.coordinate_frames import BODIES

STORED = "fbench"  # Encoding of channels whose messages the container gives decoded
_ROS, _FOXGLOVE = ("cdr", "ros1"), ("protobuf", "json")
_MAX_TRIES, _MAX_SEARCHED = 10, 1000  # First messages that may be damaged, or hold nothing
_MAX_VIDEO = 64  # Messages in which a keyframe is looked for
_TRUTH_WORDS = ("truth", "gt", "label", "annotation")


@dataclass(frozen=True)
class Role:
    """The meaning of one channel."""

    kind: str
    """`camera`, `lidar`, `radar`, `pose`, `calibration`, `transform`, `truth`; `detections`: of another system;
    `odometry`: poses that count only where the user names their topic."""
    topic: str
    sensor: str = ""
    frame_id: str = ""  # Coordinate frame of the sensor; of odometry that whose pose is given, where messages name it
    codec: Codec | None = None  # `None` where the container gives decoded messages
    numbered: bool = False  # Whether the container's sequence number is the frame number
    size_wh: tuple[int, int] | None = None
    world: str = ""  # Coordinate frame in which poses are given, where messages name it
    is_own: bool = False  # Whether fbench wrote the channel
    same_as: str = ""  # Topic that holds the measurements of the same device in a better form

    @property
    def is_static(self) -> bool:
        """Whether transforms of the channel hold until another one comes."""
        return self.is_own or "static" in self.topic


def sensor_roles(roles: Mapping[int, Role]) -> list[Role]:
    """Return the roles of cameras, LiDARs and radars, in the order of their channels' ids."""
    return [role for _, role in sorted(roles.items()) if role.kind in SENSORS]


def roles(container: Container, decoders: Sequence[NamedDecoder] = ()) -> dict[int, Role]:
    """Roles of the channels that fbench or a decoder understands, by id; the other topics are counted. Raises LogError
    where one topic holds messages of two schemas that both are understood, unless both are transforms: bags of ROS 1
    often have `tf/tfMessage` and `tf2_msgs/TFMessage` on `/tf`. Raises ConfigError where a decoder fits nothing.
    """
    found: dict[int, Role] = {}
    foreign: dict[int, Codec] = {}
    unused: dict[int, Channel] = {}
    codecs = Codecs(container, decoders)
    _require_use(container, decoders)
    for id_, channel in sorted(container.channels.items(), key=lambda item: (item[1].topic, item[0])):
        topic = channel.topic
        try:
            codec = codecs.of(channel)
        except UnsupportedError as error:
            container.once(UNREAD_SENSOR, (topic,), f"topic '{topic}' is left out: {error}")
            continue
        except DecodeError as error:  # a damaged or hostile definition makes its topic unreadable, not the log
            container.once("LOG008", (topic,), f"topic '{topic}' can't be decoded: {error}")
            codec = None
        own = _read_own(channel, codec)
        if own is not None and (channel.encoding == STORED or (codec is not None and own.kind in codec.kinds)):
            found[id_] = own
        elif codec is not None:
            foreign[id_] = codec
        else:
            unused[id_] = channel
    for id_, channel in ((id_, channel) for id_, channel in unused.items() if id_ not in codecs.metadata):
        is_missed = bool(container.counts.get(id_)) and looks_like_sensor(channel)
        what = f"topic '{channel.topic}' has {describe_unread(channel)}"
        if is_missed and "--decoder" not in what:
            what += "; a decoder plug-in can read it, named with --decoder"
        container.once(UNREAD_SENSOR if is_missed else UNREAD, (channel.topic,), what)
    schemas: dict[str, str] = {}
    transforms = {id_ for id_, codec in foreign.items() if codec.kinds == ("transform",)}
    for id_ in sorted({*found, *foreign} - transforms):
        topic, name = container.channels[id_].topic, container.channels[id_].schema_name
        if schemas.setdefault(topic, name) != name:
            two = f"{schemas[topic]} and {name}"
            raise LogError(f"{container.path}: topic '{topic}' has messages of two schemas, {two}", "LOG009")
    return found | _probe_all(container, foreign)


def describe_unread(channel: Channel) -> str:
    """Say what the messages of a channel are that fbench doesn't read, and what helps where its encoding is why."""
    text = f"type '{channel.schema_name or 'unknown'}' (encoding {channel.encoding or 'none'})"
    if channel.encoding in _ROS and channel.schema_name:
        from fbench.replay.logs.codecs.ros.codec import lacks_definition

        return f"{text}, whose definition the log doesn't hold" if lacks_definition(channel) else text
    if channel.encoding in (*_ROS, *_FOXGLOVE) and not channel.schema_name:
        return f"{text}, without a schema that says what it is"
    is_known = channel.encoding in ("", *_FOXGLOVE, STORED)
    return text if is_known else f"{text}, an encoding that only a decoder plug-in can read; name one with --decoder"


SENSOR_WORDS = ("packet", "scan", "cloud", "points", "image", "video", "lidar", "radar")
"""In names of topics and types with measurements."""
_OTHER_WORDS = ("imu", "gps", "gnss", "status", "state", "diagnos", "info", "config", "metadata", "health", "depth",
                "marker", "parameter", "event")  # fmt: skip
_OTHER_PACKAGES = ("std_msgs", "geometry_msgs", "nav_msgs", "diagnostic_msgs", "rosgraph_msgs", "rcl_interfaces",
                   "visualization_msgs", "tf2_msgs")  # fmt: skip


def looks_like_sensor(channel: Channel) -> bool:
    """Tell by the names of its topic and type whether a channel seems to hold what a camera, LiDAR or radar measured,
    rather than what is known of a sensor's state, or was made of its measurements.
    """
    name, package = f"{channel.topic} {channel.schema_name}".lower(), channel.schema_name.partition("/")[0]
    is_measured = any(word in name for word in SENSOR_WORDS) and not any(word in name for word in _OTHER_WORDS)
    return is_measured and package not in _OTHER_PACKAGES


def _require_use(container: Container, decoders: Sequence[NamedDecoder]) -> None:
    channels = container.channels.values()
    for named in decoders:
        if named.is_required and not any(named.codec(channel) for channel in channels):
            types, topics = named.decoder.types, named.decoder.topics
            on = f"{' on ' if types else ''}a topic like {' or '.join(topics)}" if topics else ""
            known = {channel.schema_name if types else channel.topic for channel in channels}
            hint = did_you_mean((*types, *topics)[0], known - {""})
            raise ConfigError(f"--decoder {named.name}: the log has no {' or '.join(types)}{on}{hint}", "CFG001")


class Codecs:
    """Codecs of channels; those of ROS once a type, as definitions take milliseconds and thousands may share one.
    Decoders that the user named go first.
    """

    def __init__(self, container: Container, decoders: Sequence[NamedDecoder] = ()) -> None:
        self._container, self._decoders = container, decoders
        self.metadata: dict[int, str] = {}
        """Channels that say how others are decoded, or hold nothing of interest, and what they hold."""
        self._ros: dict[tuple[str, Schema | None], Codec | None] = {}

    def of(self, channel: Channel) -> Codec | None:
        """Return a channel's codec, where there is one. Raises DecodeError where its definition is damaged,
        UnsupportedError where the log lacks what is needed to decode it.
        """
        for named in self._decoders:
            if (codec := named.codec(channel)) is not None:
                return codec
        if channel.encoding in _FOXGLOVE:
            from fbench.replay.logs.codecs.foxglove.codec import foxglove_codec

            return foxglove_codec(channel)
        if channel.encoding not in _ROS:
            return None
        from fbench.replay.logs.codecs.ros.codec import ros_codec
        from fbench.replay.logs.codecs.ros.definitions import full_name
        from fbench.replay.logs.codecs.ros.ouster import PACKETS, ouster_codec

        if full_name(channel.schema_name) in PACKETS:
            ouster, metadata = ouster_codec(self._container, channel)
            self.metadata |= metadata
            return ouster
        key = channel.encoding, channel.schema
        if key not in self._ros:
            self._ros[key] = ros_codec(channel)
        return self._ros[key]


def _read_own(channel: Channel, codec: Codec | None) -> Role | None:
    """Read channel metadata as fbench writes them; `None` where they aren't there."""
    kind, sensor = channel.metadata.get(KIND), channel.metadata.get(SENSOR, "")
    if kind is None or (kind in (*SENSORS, "pose", "calibration") and SENSOR not in channel.metadata):
        return None
    width, _, height = channel.metadata.get(SIZE, "").partition("x")
    size_wh = (int(width), int(height)) if width.isdecimal() and height.isdecimal() else None
    numbered = channel.metadata.get(FRAME_NUMBER) == SEQUENCE
    return Role(kind, channel.topic, sensor, sensor, codec, numbered, size_wh, is_own=True)


def _probe_all(container: Container, codecs: Mapping[int, Codec]) -> dict[int, Role]:
    """Find kind and sensor of channels without our metadata from their first messages."""
    probed = {id_: _probe(container, id_, codec) for id_, codec in codecs.items()}
    probes = {id_: probe for id_, probe in probed.items() if probe is not None}
    topics = {id_: container.channels[id_].topic for id_ in probes}
    built_in = {id_: probe for id_, probe in probes.items() if not isinstance(codecs[id_], PluginCodec)}
    repeats = _find_repeats(container, probes, built_in.keys())
    frames = {(topics[id_], p.frame_id) for id_, p in probes.items() if p.kind in SENSORS and id_ not in repeats}
    shared = Counter(frame for _, frame in frames)
    found: dict[int, Role] = {}
    for id_, (kind, frame, world, doubt) in probes.items():
        topic, codec = topics[id_], codecs[id_]
        if doubt:
            container.once("TIM013", (topic,), f"topic '{topic}': {doubt}")
        if kind in SENSORS:
            is_name = frame and frame not in BODIES and shared[frame] == 1 and id_ not in repeats
            name = frame if is_name else topic.strip("/")
            found[id_] = Role(kind, topic, name, frame, codec, same_as=repeats.get(id_, ""))
            continue
        # Boxes on a topic that isn't called like ground truth are what some system detected.
        words = topic.lower().replace("_", "/").split("/")
        is_named = any(word.startswith(_TRUTH_WORDS) for word in words) or "groundtruth" in words
        is_detected, of = kind == "truth" and not is_named, frame if kind == "odometry" else ""
        found[id_] = Role("detections" if is_detected else kind, topic, topic.strip("/"), of, codec, world=world)
    return found


_RAW = ("VelodyneScan", "PandarScan", "NebulaPackets", "PacketMsg", "CustomMsg", "ClusterList", "EsrEthTx")
_THIN = ("LaserScan", "Object", "Track")


def _detail(schema: str) -> int:
    """Rank the forms in which drivers publish what a LiDAR or radar measured: 0 for points, 1 for raw forms of them, 2
    for a plane of them, or the objects that the sensor sees in them.
    """
    name = schema.rpartition("/")[2]
    return 2 if any(word in name for word in _THIN) else 1 if any(word in name for word in _RAW) else 0


def _find_repeats(container: Container, probes: Mapping[int, Probe], built_in: Collection[int]) -> dict[int, str]:
    """Find channels with another form of what a better channel has: topics of these, by id of the others. Both are in
    one coordinate frame; packets of an Ouster, which name none, are in the namespace of the cloud. What the user's own
    decoders read, not one that is `built_in`, counts as points.
    """
    names = {id_: container.channels[id_].schema_name for id_, p in probes.items() if p.kind in SENSORS[1:]}
    ranks = {id_: _detail(name) if id_ in built_in else 0 for id_, name in names.items()}
    found: dict[int, str] = {}
    for id_ in (id_ for id_, rank in ranks.items() if rank):
        channel, probe = container.channels[id_], probes[id_]
        is_nameless = channel.schema_name.endswith("PacketMsg")
        for other in (other for other, rank in ranks.items() if rank < ranks[id_] and probes[other].kind == probe.kind):
            topic = container.channels[other].topic
            is_near = is_nameless and topic.rpartition("/")[0] == channel.topic.rpartition("/")[0]
            frame = probes[other].frame_id
            if is_near or (frame == probe.frame_id and frame and frame not in BODIES):
                found.setdefault(id_, topic)
    return found


def _probe(container: Container, channel: int, codec: Codec) -> Probe | None:
    """Kind and coordinate frame of measurements or poses, from the first readable message, if there is any."""
    if codec.kinds[0] not in (*MESSAGES, "odometry"):
        return Probe(codec.kinds[0], "")
    topic = container.channels[channel].topic
    for tried, entry in enumerate(container.entries(frozenset([channel]))):
        if not isinstance(entry.data, memoryview):
            break
        try:
            probe = _probe_message(codec, entry.data, Origin("", entry.log_ns, entry.publish_ns))
            if probe.kind == "camera":
                _probe_order(container, channel, codec)
            return probe
        except NothingError:
            if tried == _MAX_SEARCHED:
                break
        except UnsupportedError as error:
            is_missed = codec.kinds[0] in SENSORS and not isinstance(error, DepthError)
            code = UNREAD_SENSOR if is_missed else UNREAD
            container.once(code, (topic,), f"topic '{topic}' is left out: {error}")
            return None
        except DecodeError as error:
            container.once("DEC001", (entry.part, entry.block, entry.offset), f"{topic} at {entry.publish_ns}: {error}")
            if tried == _MAX_TRIES:
                break
    return None


def _probe_message(codec: Codec, data: memoryview, origin: Origin) -> Probe:
    return codec.probe_at(data, origin) if isinstance(codec, PluginCodec) else codec.probe(data)


def _probe_order(container: Container, channel: int, codec: Codec) -> None:
    """Look at the first pictures of a camera. Raises UnsupportedError where they are a video that is out of order."""
    order = OrderProbe()
    for entry in islice(container.entries(frozenset([channel])), _MAX_VIDEO):
        image: Message | None = None
        if isinstance(entry.data, memoryview):
            with suppress(DecodeError):
                image = codec.message("camera", entry.data, Origin("", entry.log_ns, entry.publish_ns))
        if isinstance(image, Image) and (image.encoding not in CODECS or order.is_done(image)):
            return


def select(roles: Mapping[int, Role], patterns: Sequence[str]) -> dict[int, Role]:
    """Keep the measurements and poses whose topic or sensor fits a pattern (`*`, `?`, `[...]`); `!` before a pattern
    leaves out what fits it. Transforms, calibrations of kept cameras and truth stay. Raises ConfigError where a pattern
    fits nothing.
    """

    def fits(role: Role, pattern: str) -> bool:
        return fnmatchcase(role.topic, pattern) or fnmatchcase(role.sensor, pattern)

    streams = {id_: role for id_, role in roles.items() if role.kind in MESSAGES}
    for pattern in patterns:
        if not any(fits(role, pattern.removeprefix("!")) for role in streams.values()):
            hint = did_you_mean(pattern, {name for role in streams.values() for name in (role.topic, role.sensor)})
            raise ConfigError(f"--topics {pattern}: fits no topic or sensor{hint}", "CFG001")
    wanted = [p for p in patterns if not p.startswith("!")] or ["*"]
    unwanted = [p[1:] for p in patterns if p.startswith("!")]
    kept = {
        id_: role
        for id_, role in streams.items()
        if any(fits(role, p) for p in wanted) and not any(fits(role, p) for p in unwanted)
    }
    gone = {role.sensor for role in streams.values()} - {role.sensor for role in kept.values()}
    return {
        id_: role
        for id_, role in roles.items()
        if (id_ in kept or id_ not in streams)
        and not (role.kind == "calibration" and role.is_own and role.sensor in gone)
    }
