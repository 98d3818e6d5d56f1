"""The codec of channels with packets of Ouster sensors, whose metadata are on a topic beside them."""

from collections.abc import Mapping, Sequence
from itertools import takewhile

import numpy as np

from fbench.replay.contracts.errors import DecodeError, UnsupportedError
from fbench.replay.data.messages import Message, PointCloud
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Assembler, Codec, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ouster import OusterFormat, read_metadata
from fbench.replay.logs.codecs.ros.cursor import Cursor
from fbench.replay.logs.codecs.ros.definitions import full_name
from fbench.replay.logs.container import Channel, Container
from fbench.replay.logs.coordinate_frames import Edge

PACKETS = frozenset(f"{package}/msg/PacketMsg" for package in ("ouster_ros", "ouster_sensor_msgs", "ouster_msgs"))
_STRING = "std_msgs/msg/String"
_FRAME = "os_lidar"
"""Coordinate frame of the points, as the driver calls it; packets don't name one."""
_SAME_CLOCK_NS = 60_000_000_000
_NUMBERS = 2**16
_MAX_LATE = 3
"""Turns that a packet may come late; a sensor that starts again counts from 0."""


def ouster_codec(container: Container, channel: Channel) -> tuple[Codec | None, Mapping[int, str]]:
    """Return the codec of a channel with packets, and the channel of its metadata with what that is; for packets of the
    IMU no codec, and their channel, as nothing is missed in them. Raises UnsupportedError where the metadata aren't in
    the log, or the packets have a form that isn't read; DecodeError where the metadata are damaged.
    """
    if "imu" in channel.topic.rpartition("/")[2].lower():
        what = "packets of the IMU, which fbench has no use for"
        return None, {id_: what for id_, other in container.channels.items() if other is channel}
    id_, text = _find_metadata(container, channel.topic)
    if id_ is None:
        raise UnsupportedError(
            "packets of an Ouster sensor need its metadata, a std_msgs/String on 'metadata' beside them"
        )
    return _OusterCodec(read_metadata(text), channel.encoding), {id_: "says how packets are decoded"}


def _find_metadata(container: Container, topic: str) -> tuple[int | None, str]:
    """Channel and text of the metadata on the topic nearest to that of the packets; of one in another namespace only
    where there is no other.
    """
    near: list[tuple[int, str, int]] = []
    for id_, channel in sorted(container.channels.items()):
        folder, _, name = channel.topic.rpartition("/")
        if full_name(channel.schema_name) == _STRING and name == "metadata":
            same = takewhile(lambda pair: pair[0] == pair[1], zip(folder.split("/"), topic.split("/"), strict=False))
            near.append((-sum(1 for _ in same), channel.topic, id_))
    if not near or (len(near) > 1 and min(near)[0] >= -1):  # all topics begin with an empty name
        return None, ""
    id_ = min(near)[2]
    entry = next(container.entries(frozenset([id_])), None)
    if entry is None or not isinstance(entry.data, memoryview):
        return None, ""
    return id_, Cursor(entry.data, container.channels[id_].encoding).string()


class _OusterCodec:
    """Implements `Codec`; messages are parts of turns."""

    kinds = ("lidar",)

    def __init__(self, form: OusterFormat, encoding: str) -> None:
        self._form, self._encoding = form, encoding

    def probe(self, data: memoryview) -> Probe:
        """Tell the coordinate frame. Raises DecodeError where the payload is damaged."""
        read_packet(data, self._encoding, self._form)
        return Probe("lidar", _FRAME)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        raise DecodeError("a packet is no whole measurement")

    def assembler(self) -> Assembler:
        return TurnAssembler(self._form, self._encoding)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        raise DecodeError("packets hold no transform")

    def stamps(self, data: memoryview) -> Sequence[int]:
        raise DecodeError("packets hold no transform")

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        raise DecodeError("packets hold no calibration")

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        raise DecodeError("packets hold no box")


def read_packet(data: memoryview, encoding: str, form: OusterFormat) -> bytes:
    """Return a copy of the packet in a PacketMsg. Raises DecodeError where it is damaged, or of another size."""
    cursor = Cursor(data, encoding)
    packet = cursor.blob()
    cursor.end()
    if len(packet) - form.packet_size not in (0, 1):  # drivers left room for a byte more
        raise DecodeError(f"packet of {len(packet)} bytes, but by the sensor's metadata it has {form.packet_size}")
    return bytes(packet[: form.packet_size])


class TurnAssembler(Assembler):
    """Joins packets to turns. A turn is whole when all its packets are there, else when the next one begins. It has the
    time of its first column; where the sensor's clock is another one than the recorder's, the log time of its first
    packet.
    """

    def __init__(self, form: OusterFormat, encoding: str) -> None:
        self._form, self._encoding = form, encoding
        self._packets: list[bytes] = []
        self._number: int | None = None
        self._first_ns = 0  # Log time of the first packet

    def take(self, data: memoryview, origin: Origin) -> Message | None:
        """Take a packet; return the turn that it shows to be whole, if any. A turn that came in part, or of which
        nothing is valid, has fewer points or is none.
        """
        packet = read_packet(data, self._encoding, self._form)
        number = self._form.frame_number(memoryview(packet))
        whole = None
        if self._number is not None and number != self._number:
            if (self._number - number) % _NUMBERS <= _MAX_LATE:
                return None  # late, of a turn that is over
            whole = self._finish(origin)
        elif self._number == number and not self._packets:
            return None  # again, of a turn that is over
        if not self._packets:
            self._first_ns = origin.log_ns
        self._number = number
        self._packets.append(packet)
        return self._finish(origin) if whole is None and len(self._packets) >= self._form.packets_per_turn else whole

    def _finish(self, origin: Origin) -> PointCloud | None:
        packets, self._packets = self._packets, []
        turn = self._form.decode(packets) if packets else None
        if turn is None:
            return None
        is_same_clock = turn.start_ns > 0 and abs(turn.start_ns - self._first_ns) <= _SAME_CLOCK_NS
        stamp_ns = turn.start_ns if is_same_clock else self._first_ns
        fits = bool(((turn.time_ns >= 0) & (turn.time_ns < 2**31)).all())
        return PointCloud(
            origin.sensor, stamp_ns, origin.log_ns, turn.xyz, turn.intensity, turn.ring,
            turn.time_ns.astype(np.int32) if fits else None, origin.frame_number,
        )  # fmt: skip
