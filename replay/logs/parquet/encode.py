"""Messages as rows: the values of a stream's columns, in their order."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from fbench.replay.arrays import Array
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.errors import DataError
from fbench.replay.logs.container import Entry
from fbench.replay.logs.parquet.columns import COLUMNS, StreamKind
from fbench.replay.logs.truth_part import TruthPart

_OVERHEAD = 400
"""What a row costs beside its large values [byte]: so that many small ones count too."""


class Encoded(NamedTuple):
    """One row."""

    values: tuple[Any, ...]
    size: int
    """About how much memory it holds [byte]."""


def message_kind(message: Message) -> StreamKind:
    """Return the kind of stream that holds such messages."""
    match message:
        case Image():
            return "camera"
        case PointCloud():
            return "lidar"
        case RadarScan():
            return "radar"
        case Pose():
            return "pose"


def message_row(message: Message, position: int) -> Encoded:
    """Encode a message.

    Raises:
        ValueError: where a text isn't Unicode.
    """
    head = (message.log_ns, message.stamp_ns, message.frame_number, position)
    return _encoded((*head, *_payload(message)))


def _payload(message: Message) -> tuple[Any, ...]:
    match message:
        case Image():
            return (_text(message.encoding), *_size_wh(message), bytes(message.data))
        case PointCloud(xyz=xyz):
            arrays = (_packed(message.intensity, "<f4"), _packed(message.ring, "<u2"))
            return (len(xyz), _packed(xyz, "<f4"), *arrays, _packed(message.offset_ns, "<i4"))
        case RadarScan(xyz=xyz):
            more = (
                message.radial_velocity_mps, message.rcs_dbsm, message.range_m, message.azimuth_rad,
                message.altitude_rad,
            )  # fmt: skip
            return (len(xyz), *(_packed(array, "<f4") for array in (xyz, *more)))
        case Pose():
            return (message.translation_m.tolist(), message.rotation_xyzw.tolist())


def _size_wh(image: Image) -> tuple[int, int]:
    if not all(0 <= size < 2**63 for size in image.size_wh):
        raise ValueError(f"size {image.size_wh}")
    return image.size_wh


def part_kind(part: TruthPart) -> StreamKind:
    """Return the kind of stream that holds such truth."""
    return "truth_2d" if part.is_2d else "truth_3d"


def part_row(part: TruthPart, position: int) -> Encoded:
    """Encode truth.

    Raises:
        ValueError: where a text isn't Unicode.
    """
    truth = part.truth
    head = (truth.log_ns, truth.stamp_ns, truth.frame_number, position, part.expects_2d, _text(part.frame_id) or None)
    boxes = truth.boxes2d if part.is_2d else truth.boxes3d
    names = list(COLUMNS[part_kind(part)])[len(head) :]
    return _encoded((*head, *_boxes(boxes, names)))


def _boxes(boxes: Boxes2D | Boxes3D | None, names: Iterable[str]) -> Iterable[Any]:
    arrays = {} if boxes is None else boxes.arrays()
    for name in names:
        values = arrays[name].tolist() if name in arrays else None
        for text in values or ():
            if isinstance(text, str):
                _text(text)
        yield values


def raw_row(entry: Entry, position: int) -> Encoded:
    """Encode a message of another program, as it is.

    Raises:
        DataError: where the entry holds a decoded message.
    """
    if not isinstance(entry.data, memoryview):
        raise DataError("holds no bytes of another program")
    return _encoded((entry.log_ns, entry.publish_ns, entry.sequence, position, bytes(entry.data)))


def _packed(array: Array | None, dtype: str) -> bytes | None:
    return None if array is None else np.ascontiguousarray(array, dtype).tobytes()


def _text(text: str) -> str:
    text.encode()
    return text


def _encoded(values: tuple[Any, ...]) -> Encoded:
    return Encoded(values, _OVERHEAD + sum(_size(value) for value in values))


def _size(value: object) -> int:
    if isinstance(value, bytes):
        return len(value)
    return sum(80 if isinstance(item, list) else 32 for item in value) if isinstance(value, list) else 0
