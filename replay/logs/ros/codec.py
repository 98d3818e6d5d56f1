"""Codec of channels with ROS messages: CDR (ROS 2) or ROS 1."""

from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

import numpy as np

from fbench.replay.data import CameraModel, Message
from fbench.replay.errors import DataError, DecodeError
from fbench.replay.logs.codec import Codec, Origin, Probe
from fbench.replay.logs.container import Channel
from fbench.replay.logs.ros.bulk import BULK
from fbench.replay.logs.ros.cursor import CDR, ROS1
from fbench.replay.logs.ros.decoder import decoder
from fbench.replay.logs.ros.definitions import full_name, has_text, types_of
from fbench.replay.logs.ros.object_reads import UNDEFINED
from fbench.replay.logs.ros.reads import Reads
from fbench.replay.logs.ros.small import SMALL
from fbench.replay.logs.tree import Edge
from fbench.replay.logs.truth_part import TruthPart

P = ParamSpec("P")
T = TypeVar("T")


def ros_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its encoding or type isn't one that fbench understands.

    Raises:
        DecodeError: where the definition that the log gives is damaged, or can't be one of this type.
    """
    name, encoding = full_name(channel.schema_name), channel.encoding
    if encoding not in (CDR, ROS1):
        return None
    if name in BULK:
        _check_standard(name, channel)
        return RosCodec(name, BULK[name](encoding))
    if name in UNDEFINED and not has_text(channel.schema):
        return None
    if name in SMALL:
        decode = decoder(name, types_of(name, channel.schema, encoding), encoding)
        return RosCodec(name, SMALL[name](decode, encoding))
    return None


def _check_standard(name: str, channel: Channel) -> None:
    given = types_of(name, channel.schema, channel.encoding)
    if given != types_of(name, None, channel.encoding):
        raise DecodeError(f"definition of {name} isn't the standard one")


class RosCodec:
    """Implements `Codec` for one type of message, `pkg/msg/Name`."""

    def __init__(self, name: str, reads: Reads) -> None:
        self._name, self._reads = name, reads

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the channel can be."""
        return self._reads.kinds

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; images that can't be shown (depth, say) are refused here already."""
        return self._call(self._reads.probe, data)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement; its stamp is 0 where the header has none."""
        return self._call(self._given(self._reads.message, "measurement"), kind, data, origin)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        """Decode transforms: child and its pose in the parent."""
        return self._call(self._given(self._reads.transforms, "transform"), data)

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        return self._call(self._given(self._reads.stamps, "transform"), data)

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        """Decode the coordinate frame and intrinsics of a camera."""
        return self._call(self._given(self._reads.calibration, "calibration"), data)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes, in the coordinate frame of their header."""
        return self._call(self._given(self._reads.truth, "box"), data, origin)

    def _given(self, function: Callable[P, T] | None, what: str) -> Callable[P, T]:
        if function is None:
            raise DecodeError(f"{self._name} holds no {what}")
        return function

    def _call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            with np.errstate(
                all="ignore"
            ):  # values that aren't finite, or out of range, are dealt with where they matter
                return function(*args, **kwargs)
        # A definition in the log may give any field another type than the one that is expected.
        except (TypeError, ValueError, OverflowError, DataError) as error:
            raise DecodeError(f"not a usable {self._name} ({error})") from error
