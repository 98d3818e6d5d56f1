"""Codec between ground truth and `foxglove.SceneUpdate`.

One message holds the boxes of one stamp: an entity a box, whose metadata are the exact values, and one entity
`frame` that says how many boxes there are and which fields they have. The keys of the metadata are the field names
of `Boxes3D` and `Boxes2D`; numbers are written so that float64 is read back exactly, parts of vectors are
separated by commas. 3D boxes also carry a cube, so that viewers draw them.
"""

import math
import struct
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.arrays import Array, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.logs.codecs.foxglove.messages import rotation, vector
from fbench.replay.logs.codecs.foxglove.proto import parse, timestamp
from fbench.replay.logs.coordinate_frames import BODY

FRAME = "frame"
_NOT_LABELLED = "none"
_WIDTHS = {"center_m": 3, "size_lwh_m": 3, "velocity_mps": 3, "xyxy_px": 4, "visible_xyxy_px": 4}
_DTYPES = {
    "label": "U", "attribute": "U", "source_label": "U", "camera": "U", "track_id": "i8", "num_lidar_pts": "i8",
    "num_radar_pts": "i8", "sources": "u1", "predicted": "?", "ignore": "?",
}  # fmt: skip
_COLORS = {
    "car": (0.12, 0.47, 0.71), "van": (0.09, 0.75, 0.81), "truck": (1.0, 0.5, 0.05), "bus": (0.58, 0.4, 0.74),
    "trailer": (0.55, 0.34, 0.29), "motorcycle": (0.89, 0.47, 0.76), "bicycle": (0.74, 0.74, 0.13),
    "pedestrian": (0.84, 0.15, 0.16),
}  # fmt: skip
_GREY = (0.5, 0.5, 0.5)
_FLAGS = {"True": True, "False": False}
_NAN = struct.pack("<d", float("nan"))

B = TypeVar("B", Boxes2D, Boxes3D)


def boxes_proto(stamp_ns: int, boxes: Boxes3D | Boxes2D | None, more: dict[str, str] | None = None) -> SceneUpdate:
    """Encode boxes, `more` being added to the metadata of the frame; `None` means not labeled."""
    scene, stamp = SceneUpdate(), timestamp(stamp_ns)
    # Viewers keep entities until they are deleted: each message replaces what the one before it drew.
    scene.deletions.add(type=SceneEntityDeletion.ALL, timestamp=stamp)
    columns = {} if boxes is None else {name: _texts(array) for name, array in boxes.arrays().items()}
    num = 0 if boxes is None else len(boxes)
    about = {"boxes": _NOT_LABELLED if boxes is None else str(num), "fields": " ".join(columns), **(more or {})}
    rows = [(FRAME, about)] + [(f"box {i}", {name: texts[i] for name, texts in columns.items()}) for i in range(num)]
    for id_, values in rows:
        entity = scene.entities.add(id=id_, frame_id=BODY, timestamp=stamp)
        for key, value in values.items():
            entity.metadata.add(key=key, value=value)
    if isinstance(boxes, Boxes3D):
        _add_cubes(scene, boxes)
    return scene


def _add_cubes(scene: SceneUpdate, boxes: Boxes3D) -> None:
    """Add cubes for viewers; boxes that aren't finite can't be drawn."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    zeros, rotations = np.zeros(len(boxes)), np.full((len(boxes), 4), np.nan)
    angles = np.stack([boxes.yaw_rad, *(zeros if a is None else a for a in (boxes.pitch_rad, boxes.roll_rad))], axis=1)
    finite = np.isfinite(angles).all(axis=1)
    if finite.any():
        rotations[finite] = Rotation.from_euler("ZYX", angles[finite]).as_quat()
    labels = [] if boxes.label is None else boxes.label.tolist()
    drawable = np.isfinite(np.concatenate([boxes.center_m, boxes.size_lwh_m, rotations], axis=1)).all(axis=1)
    for i in np.flatnonzero(drawable):
        r, g, b = _COLORS.get(labels[i], _GREY) if labels else _GREY
        pose = PoseProto(position=vector(boxes.center_m[i]), orientation=rotation(rotations[i]))
        scene.entities[i + 1].cubes.add(pose=pose, size=vector(boxes.size_lwh_m[i]), color=Color(r=r, g=g, b=b, a=0.5))


def read_boxes(data: memoryview, kind: type[B]) -> tuple[B | None, dict[str, str]]:
    """Decode boxes and the metadata of their frame. Raises DecodeError where `boxes_proto` didn't make the message."""
    scene = parse(SceneUpdate, data)
    entities = {entity.id: {pair.key: pair.value for pair in entity.metadata} for entity in scene.entities}
    frame = entities.get(FRAME)
    if frame is None or "boxes" not in frame:
        raise DecodeError("truth without an entity 'frame'")
    if frame["boxes"] == _NOT_LABELLED:
        return None, frame
    try:
        rows = [entities[f"box {i}"] for i in range(int(frame["boxes"]))]
        known = {f.name for f in fields(kind)}
        names = [name for name in frame.get("fields", "").split() if name in known]
        columns: dict[str, Any] = {name: _array(name, [row[name] for row in rows]) for name in names}
        return kind(**columns), frame
    except (KeyError, ValueError, OverflowError, TypeError, struct.error, DataError) as error:
        raise DecodeError(f"truth is incomplete or damaged ({error})") from error


def _texts(array: Array) -> list[str]:
    """One text a row."""
    if array.ndim == 2:
        return [", ".join(_number(v) for v in row) for row in array.tolist()]
    write = _number if array.dtype.kind == "f" else str
    return [write(v) for v in array.tolist()]


def _array(name: str, texts: list[str]) -> Array:
    dtype = np.dtype(_DTYPES.get(name, "f8"))
    if dtype.kind == "U":
        return text_array(texts)
    if name in _WIDTHS:
        values = [[_float(part) for part in text.split(", ")] for text in texts]
        return np.array(values, np.float64).reshape(len(texts), _WIDTHS[name])
    read = {"b": _FLAGS.__getitem__, "f": _float}.get(dtype.kind, int)
    return np.array([read(text) for text in texts], dtype)


def _number(value: float) -> str:
    """Shortest text that reads back as the same float64, the bits of a NaN included."""
    if not math.isnan(value):
        return repr(value)
    bits = struct.pack("<d", value)
    return "nan" if bits == _NAN else f"nan:{bits.hex()}"


def _float(text: str) -> float:
    return struct.unpack("<d", bytes.fromhex(text[4:]))[0] if text.startswith("nan:") else float(text)
