"""The codec of channels with ROS messages: CDR (ROS 2) or ROS 1."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import SENSORS, Assembler, Codec, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros import boxes, camera, clouds, delphi, lidars, poses, radar_lists, video
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1
from fbench.replay.logs.codecs.ros.decoder import Decode, decoder, header
from fbench.replay.logs.codecs.ros.definitions import full_name, has_text, types_of
from fbench.replay.logs.codecs.ros.ouster import PACKETS
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.coordinate_frames import Edge

T = TypeVar("T")
_NUM_KEPT = 32  # Definitions, which topics and files of a recording share; one takes some 10 ms


@dataclass(frozen=True)
class _Type:
    """Functions of decoded messages of a type and their encoding; `None` where the type holds no such thing."""

    kinds: tuple[str, ...]
    message: Callable[[str, Any, str, Origin], Message] | None = None
    transforms: Callable[[Any], Sequence[tuple[str, Edge]]] | None = None
    calibration: Callable[[Any, str], tuple[str, CameraModel]] | None = None
    truth: Callable[[Any, str, Origin], TruthPart] | None = None
    probe: Callable[[Any, str], Probe] | None = None  # `None`: the header of sensors tells the coordinate frame
    layout: Callable[[memoryview, str], Any] | None = None
    """Decodes a payload of an encoding by the standard's definition, and no other, without rosbags."""
    number: Callable[[Any], int] | None = None
    """Which part of a measurement a message is, where several make one up."""
    needs_definition: bool = False  # Of the log: there are several generations of the type


_TF = _Type(("transform",), transforms=poses.transforms)


def _radar(layout: radar_lists.RadarList) -> _Type:
    return _Type(("radar",), radar_lists.make_reader(layout), probe=radar_lists.probe, needs_definition=True)


_LIVOX = _Type(("lidar",), lidars.livox_sweep, probe=lidars.probe, layout=lidars.read_livox)
_POSE = _Type(("odometry",), poses.pose, probe=poses.probe_pose)
_TYPES: Mapping[str, _Type] = {
    "sensor_msgs/msg/PointCloud2": _Type(
        ("lidar", "radar"), clouds.cloud_message, probe=clouds.probe_cloud, layout=clouds.read_cloud
    ),
    "sensor_msgs/msg/LaserScan": _Type(("lidar",), lidars.planar_scan, probe=lidars.probe, layout=lidars.read_rays),
    "sensor_msgs/msg/MultiEchoLaserScan": _Type(
        ("lidar",), lidars.planar_scan, probe=lidars.probe, layout=lidars.read_echoes
    ),
    "livox_ros_driver/msg/CustomMsg": _LIVOX,
    "livox_ros_driver2/msg/CustomMsg": _LIVOX,
    "velodyne_msgs/msg/VelodyneScan": _Type(
        ("lidar",), lidars.velodyne_sweep, probe=lidars.probe_velodyne, layout=lidars.read_velodyne
    ),
    **{
        name: _Type(("lidar",), lidars.hesai_sweep, probe=lidars.probe_hesai, layout=layout)
        for name, layout in (
            ("pandar_msgs/msg/PandarScan", lidars.read_pandar),
            ("hesai_lidar/msg/PandarScan", lidars.read_pandar),
            ("nebula_msgs/msg/NebulaPackets", lidars.read_nebula),
        )
    },
    "foxglove_msgs/msg/LaserScan": _Type(
        ("lidar",), lidars.foxglove_scan, probe=lidars.probe_foxglove, needs_definition=True
    ),
    "sensor_msgs/msg/Image": _Type(
        ("camera",), camera.raw_image, probe=camera.probe_image, layout=camera.read_raw_image
    ),
    "sensor_msgs/msg/CompressedImage": _Type(
        ("camera",), camera.decode_compressed_image, probe=camera.probe_image, layout=camera.read_compressed_image
    ),
    **{
        name: _Type(("camera",), video.read_video, probe=video.probe_video)
        for name in (
            "foxglove_msgs/msg/CompressedVideo",
            "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
            "ffmpeg_image_transport/msg/FFMPEGPacket",
            "h264_msgs/msg/Packet",
            "h264_image_transport/msg/H264Packet",
            "h264_image_transport_msgs/msg/H264Packet",
            "x264_image_transport/msg/x264Packet",
        )
    },
    "theora_image_transport/msg/Packet": _Type(("camera",), probe=video.refuse_theora),
    "sensor_msgs/msg/CameraInfo": _Type(("calibration",), calibration=camera.camera_model),
    "radar_msgs/msg/RadarScan": _Type(("radar",), clouds.radar_scan),
    "delphi_esr_msgs/msg/EsrEthTx": _Type(("radar",), delphi.ethernet_scan, needs_definition=True),
    "delphi_esr_msgs/msg/EsrTrack": _Type(
        ("radar",), delphi.esr_return, number=delphi.return_number, needs_definition=True
    ),
    "delphi_mrr_msgs/msg/MrrDetection": _Type(
        ("radar",), delphi.mrr_return, number=delphi.return_number, needs_definition=True
    ),
    **{name: _radar(layout) for name, layout in radar_lists.KNOWN.items()},
    "tf2_msgs/msg/TFMessage": _TF,
    "tf/msg/tfMessage": _TF,
    "nav_msgs/msg/Odometry": _POSE,
    "geometry_msgs/msg/PoseStamped": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
    "vision_msgs/msg/Detection2DArray": _Type(("truth",), truth=boxes.detections2d),
    "vision_msgs/msg/Detection3DArray": _Type(("truth",), truth=boxes.detections3d),
    "radar_msgs/msg/RadarTracks": _Type(("truth",), truth=boxes.radar_tracks),
    **{
        f"{package}/msg/{name}Objects": _Type(("truth",), truth=boxes.autoware_objects, needs_definition=True)
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("Detected", "Tracked", "Predicted")
    },
    **{
        f"derived_object_msgs/msg/{name}Array": _Type(
            ("truth",), truth=boxes.decode_derived_objects, needs_definition=True
        )
        for name in ("Object", "ObjectWithCovariance")
    },
    "foxglove_msgs/msg/SceneUpdate": _Type(("truth",), truth=boxes.scene_update, needs_definition=True),
    "visualization_msgs/msg/MarkerArray": _Type(("detections",), truth=boxes.marker_boxes),
}
"""All types that fbench reads."""


def ros_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its encoding or type isn't one that fbench understands. Raises
    DecodeError where the definition that the log gives is damaged, or can't be one of this type.
    """
    name, encoding = full_name(channel.schema_name), channel.encoding
    known = _TYPES.get(name)
    if known is None and encoding in (CDR, ROS1):
        known = _recognize(name, channel)
    if encoding not in (CDR, ROS1) or known is None or (known.needs_definition and not has_text(channel.schema)):
        return None
    if (layout := known.layout) is None:
        return _RosCodec(name, known, encoding, _compile(name, channel.schema, encoding))
    if _is_standard(name, channel.schema, encoding):
        return _RosCodec(name, known, encoding, lambda data: layout(data, encoding))
    raise DecodeError(f"definition of {name} isn't the standard one")


@lru_cache(_NUM_KEPT)
def _compile(name: str, schema: Schema | None, encoding: str) -> Decode:
    return decoder(name, types_of(name, schema, encoding), encoding)


@lru_cache(_NUM_KEPT)
def _is_standard(name: str, schema: Schema | None, encoding: str) -> bool:
    given, standard = (types_of(name, each, encoding, by_rosbags=False) for each in (schema, None))
    return given == standard


def ros_types() -> Mapping[str, tuple[str, ...]]:
    """What channels can be, by the name of their type; types that are only refused with a reason are left out."""
    read = {n: t.kinds for n, t in _TYPES.items() if t.message or t.transforms or t.calibration or t.truth}
    return dict(sorted({**read, **dict.fromkeys(PACKETS, ("lidar",))}.items()))


def lacks_definition(channel: Channel) -> bool:
    """Tell whether a channel's type is one that fbench can't read without the definition, which the log doesn't hold
    in a form that is read.
    """
    known = _TYPES.get(full_name(channel.schema_name))
    return known is not None and known.needs_definition and not has_text(channel.schema)


def _recognize(name: str, channel: Channel) -> _Type | None:
    """Find out whether a type that isn't known by its name is a list of radar returns."""
    schema = channel.schema
    if schema is None or not has_text(schema) or not radar_lists.may_be_list(schema.data):
        return None
    with suppress(DecodeError):  # a damaged definition of a type that fbench may have no use for
        layout = radar_lists.recognize(name, types_of(name, schema, channel.encoding))
        return None if layout is None else _radar(layout)
    return None


class _RosCodec:
    """Implements `Codec` for one type of message, `pkg/msg/Name`."""

    def __init__(self, name: str, known: _Type, encoding: str, decode: Decode) -> None:
        self._name, self._type, self._encoding, self._decode = name, known, encoding, decode

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._type.kinds

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; images that can't be shown (depth, say) are refused here already."""
        with self._guard(self._type.probe or self._probe_header, "") as probe:
            return probe(self._decode(data), self._encoding)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement; its stamp is 0 where the header has none."""
        with self._guard(self._type.message, "measurement") as read:
            return read(kind, self._decode(data), self._encoding, origin)

    def assembler(self) -> Assembler | None:
        """Make one where a message is a part of a scan."""
        return None if self._type.number is None else delphi.ReturnAssembler(self._number_scan)

    def _number_scan(self, data: memoryview, origin: Origin) -> tuple[int, RadarScan]:
        with self._guard(self._type.number, "return") as number:
            scan = self.message("radar", data, origin)
            if not isinstance(scan, RadarScan):
                raise DecodeError(f"{self._name} holds no return")
            return number(self._decode(data)), scan

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        with self._guard(self._type.transforms, "transform") as read:
            return read(self._decode(data))

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        with self._guard(self._type.transforms and poses.stamps, "transform") as read:
            return read(self._decode(data), self._encoding)

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        with self._guard(self._type.calibration, "calibration") as read:
            return read(self._decode(data), self._encoding)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes, in the coordinate frame of their header."""
        with self._guard(self._type.truth, "box") as read:
            return read(self._decode(data), self._encoding, origin)

    def _probe_header(self, message: Any, encoding: str) -> Probe:
        is_sensor = self.kinds[0] in (*SENSORS, "calibration")
        return Probe(self.kinds[0], header(message, encoding).frame_id if is_sensor else "")

    @contextmanager
    def _guard(self, function: T | None, what: str) -> Iterator[T]:
        if function is None:
            raise DecodeError(f"{self._name} holds no {what}")
        try:
            # Values that aren't finite, or out of range, are dealt with where they matter.
            with np.errstate(all="ignore"):
                yield function
        # A definition in the log may give any field another type than the one that is expected.
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError, DataError) as error:
            raise DecodeError(f"not a usable {self._name} ({error})") from error
