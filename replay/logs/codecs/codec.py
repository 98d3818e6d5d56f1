"""The interface of codecs: payloads of one encoding to messages, transforms, calibrations and truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.coordinate_frames import Edge


@dataclass(frozen=True, eq=False)
class TruthPart:
    """3D boxes, or 2D ones that belong to the 3D ones of the same instant where there are any."""

    truth: Truth
    is_2d: bool
    expects_2d: bool = False  # Whether 2D boxes of the same instant follow
    frame_id: str = ""
    """Coordinate frame of the boxes, of 2D boxes that of the camera; empty: the body, and cameras by name."""
    frame_ids: tuple[str, ...] = ()
    """Coordinate frame of each 3D box, where they are in several; `frame_id` is one of them."""


def split_truth(truth: Truth) -> Iterator[TruthPart]:
    """Yield 3D boxes first, also where they are absent, which says that 2D ones follow."""
    has_2d = truth.boxes2d is not None
    yield TruthPart(replace(truth, boxes2d=None), is_2d=False, expects_2d=has_2d)
    if has_2d:
        yield TruthPart(replace(truth, boxes3d=None), is_2d=True)


def part_of(truth: Truth, frame_ids: tuple[str, ...], otherwise: str = "") -> TruthPart:
    """Make a part of 3D boxes that each name a coordinate frame; `otherwise` is that of those which name none."""
    names = tuple(name or otherwise for name in frame_ids)
    first = next((name for name in names if name), otherwise)
    return TruthPart(truth, is_2d=False, frame_id=first, frame_ids=names if len(set(names)) > 1 else ())


MESSAGES = ("camera", "lidar", "radar", "pose")
SENSORS = ("camera", "lidar", "radar")


@dataclass(frozen=True)
class Origin:
    """What the container says about one message."""

    sensor: str
    log_ns: int
    publish_ns: int
    frame_number: int | None = None
    size_wh: tuple[int, int] | None = None  # Of images whose channel states it, as those that fbench wrote do


class Probe(NamedTuple):
    """What a message says about its channel."""

    kind: str
    frame_id: str  # Coordinate frame of the sensor, or the one whose pose is given
    world: str = ""  # Coordinate frame in which poses are given
    doubt: str = ""  # Which times of points aren't understood


class Assembler(Protocol):
    """Joins the messages of one channel, several of which make up a measurement, on one pass over the log."""

    def take(self, data: memoryview, origin: Origin) -> Message | None:
        """Take a message, in the order of the channel; return the measurement that it shows to be whole, if any, with
        its log time. Raises DecodeError where it is damaged: what it would have completed goes on without it.
        """


class NothingError(DecodeError):
    """A message that holds nothing of what its channel is read for: it is passed over, and no fault."""


class Codec(Protocol):
    """Decodes the payloads of one channel. Payloads are views of buffers that outlive the call: what is kept of them
    must be copied, once. All methods raise DecodeError where a payload is damaged, and nothing else.
    """

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the channel can be: `camera`, `lidar`, `radar`, `pose`, `calibration`, `transform`, `truth`."""

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame from the first message of a channel."""

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement or pose."""

    def assembler(self) -> Assembler | None:
        """Make a new assembler for one pass; `None` where each message is a measurement."""

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        """Decode transforms: child and its pose in the parent."""

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        """Decode the coordinate frame and intrinsics of a camera."""

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes."""
