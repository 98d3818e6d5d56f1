"""Decoders: plug-ins that read messages of types that fbench doesn't know. What they get, declare and return."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth

DecoderKind: TypeAlias = Literal["camera", "lidar", "radar", "pose", "boxes"]


@dataclass(frozen=True, eq=False)
class Payload:
    """One recorded message, and what the log says about its type."""

    data: bytes
    """The message as recorded; without compression of the log."""
    topic: str
    log_ns: int
    """When it was recorded [ns]."""
    publish_ns: int
    """When it was sent, where the log knows; else as `log_ns`."""
    encoding: str
    """Of the message: `cdr`, `ros1`, `protobuf`, `json` or whatever the recorder wrote."""
    schema_name: str
    """Name of its type, such as `acme_msgs/msg/Targets`; empty where there is none."""
    schema_encoding: str = ""
    """Of its definition: `ros2msg`, `ros1msg`, `protobuf`, `jsonschema` ..."""
    schema_data: bytes = b""
    """Its definition as the log has it, maybe none."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Of the channel."""
    parse: Callable[[], Any] = lambda: None
    """Makes `message`."""

    @cached_property
    def message(self) -> Any:
        """The message by its definition: an object with the fields for ROS, a Protobuf message, what JSON holds. Raises
        DecodeError where the log has no definition, it can't be used, or the encoding is another one.
        """
        return self.parse()


class BoxesIn(NamedTuple):
    """Boxes in another coordinate frame than the body's: of a sensor, or one in which the log's poses are."""

    truth: Truth
    frame_id: str
    """Of 2D boxes that of their camera."""


Decoded: TypeAlias = Message | Truth | BoxesIn
RESULTS: Mapping[DecoderKind, tuple[type, ...]] = {
    "camera": (Image,), "lidar": (PointCloud,), "radar": (RadarScan,), "pose": (Pose,), "boxes": (Truth, BoxesIn),
}  # fmt: skip
"""What a decoder of each kind returns."""


@dataclass(frozen=True, eq=False)
class Decoder:
    """A function that decodes messages, and which ones."""

    function: Callable[[Payload], Decoded | None]
    kind: DecoderKind
    types: tuple[str, ...] = ()
    """Names of types, as schemas have them; empty: any."""
    topics: tuple[str, ...] = ()
    """Patterns of topics (`*`, `?`, `[...]`); empty: any."""
    definition: str = ""
    """Definition of a ROS type as a .msg text, for logs that don't hold it."""

    def __call__(self, payload: Payload) -> Decoded | None:
        """Decode one message."""
        return self.function(payload)

    def fits(self, topic: str, type_name: str) -> bool:
        """Tell whether it is for messages of a type on a topic; `pkg/Name` is `pkg/msg/Name`."""
        types = {_plain_type(name) for name in self.types}
        is_type = not types or _plain_type(type_name) in types
        return is_type and (not self.topics or any(fnmatchcase(topic, pattern) for pattern in self.topics))


def _plain_type(name: str) -> str:
    return name.replace("/msg/", "/")


def decodes(
    *types: str, kind: DecoderKind, topics: Sequence[str] = (), definition: str = ""
) -> Callable[[Callable[[Payload], Decoded | None]], Decoder]:
    """Make a decoder of the function below it.

    The function gets a `Payload` and returns what its kind says: an `Image`, `PointCloud`, `RadarScan`, `Pose`, or for
    boxes a `Truth` in body coordinates (or, with `in_world`, in those of the world) or `BoxesIn`; `None` where the
    message holds nothing. Its result may depend on nothing but the payload. `sensor` of a measurement is the name of
    the sensor's coordinate frame in the log's transforms, of a pose that of the coordinate frame whose pose it is;
    empty: the topic names the sensor, and the pose is the body's. `log_ns` needn't be right.

    Args:
        types: Names of the types that it decodes, as the log's schemas have them.
        kind: What it returns: camera, lidar, radar, pose or boxes.
        topics: Patterns; with types, both must fit. For logs without schemas.
        definition: Of a ROS type as a .msg text, where logs don't hold it; types that it uses follow as in MCAP.

    Raises:
        ConfigError: where neither types nor topics are named, or the kind isn't known.
    """
    if kind not in get_args(DecoderKind):
        raise ConfigError(f"@decodes: kind '{kind}' is none of {', '.join(get_args(DecoderKind))}")
    if not types and not topics:
        raise ConfigError("@decodes: name the types that it decodes, or topics=")
    return lambda function: Decoder(function, kind, tuple(types), tuple(topics), definition)


def load_decoder(name: str) -> Decoder:
    """Return the decoder of an entry point, or that of `FILE.py:FUNCTION`. Raises ConfigError as `load` does, and where
    it isn't a decoder.
    """
    found = load("decoders", name, Decoder)
    if not isinstance(found, Decoder):
        raise ConfigError(f"decoder '{name}' is a {type(found).__name__}, no function below @decodes(TYPE, kind=KIND)")
    return found
