"""Columns of each kind of stream, their check, and the names of topics and files."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import Literal

import pyarrow as pa

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.logs.codecs.foxglove.topics import BOXES2D, BOXES3D

StreamKind = Literal["camera", "lidar", "radar", "pose", "truth_3d", "truth_2d", "raw"]


class Content(Enum):
    """What a column holds: the Arrow type that is written; others of the same meaning are read too."""

    INT = pa.int64()
    UINT = pa.uint64()
    FLAG = pa.bool_()
    TEXT = pa.string()
    BYTES = pa.binary()
    VEC3 = pa.list_(pa.float64(), 3)
    VEC4 = pa.list_(pa.float64(), 4)
    FLOATS = pa.list_(pa.float64())
    INTS = pa.list_(pa.int64())
    SMALL = pa.list_(pa.uint8())
    FLAGS = pa.list_(pa.bool_())
    TEXTS = pa.list_(pa.string())
    VECS3 = pa.list_(pa.list_(pa.float64(), 3))
    VECS4 = pa.list_(pa.list_(pa.float64(), 4))

    @property
    def is_nested(self) -> bool:
        """Whether a row holds more than one value."""
        return bool(pa.types.is_nested(self.value))


@dataclass(frozen=True)
class Column:
    """One column; those that aren't needed may be absent from the files of others."""

    content: Content
    needed: bool = False


_INT, _NEED_INT = Column(Content.INT), Column(Content.INT, True)
_BYTES, _NEED_BYTES = Column(Content.BYTES), Column(Content.BYTES, True)
_HEAD = {"log_ns": _NEED_INT, "stamp_ns": _NEED_INT, "frame_number": _INT, "position": _INT}
_POINTS = {**_HEAD, "num_points": _INT, "xyz": _NEED_BYTES}
_BOX_CONTENT = {
    "center_m": Content.VECS3, "size_lwh_m": Content.VECS3, "velocity_mps": Content.VECS3, "xyxy_px": Content.VECS4,
    "visible_xyxy_px": Content.VECS4, "camera": Content.TEXTS, "label": Content.TEXTS, "attribute": Content.TEXTS,
    "source_label": Content.TEXTS, "track_id": Content.INTS, "num_lidar_pts": Content.INTS,
    "num_radar_pts": Content.INTS, "sources": Content.SMALL, "predicted": Content.FLAGS, "ignore": Content.FLAGS,
}  # fmt: skip
BOXES_NEEDED = ("center_m", "size_lwh_m", "yaw_rad", "camera", "xyxy_px")  # Null where nothing is labeled


def _truth(kind: type[Boxes2D] | type[Boxes3D]) -> dict[str, Column]:
    head = {**_HEAD, "expects_2d": Column(Content.FLAG), "frame_id": Column(Content.TEXT)}
    names = [f.name for f in fields(kind)]
    return head | {name: Column(_BOX_CONTENT.get(name, Content.FLOATS), name in BOXES_NEEDED) for name in names}


COLUMNS: Mapping[StreamKind, Mapping[str, Column]] = {
    "camera": {
        **_HEAD, "encoding": Column(Content.TEXT, True), "width": _NEED_INT, "height": _NEED_INT, "data": _NEED_BYTES,
    },
    "lidar": {**_POINTS, "intensity": _BYTES, "ring": _BYTES, "offset_ns": _BYTES},
    "radar": {
        **_POINTS, "radial_velocity_mps": _BYTES, "rcs_dbsm": _BYTES, "range_m": _BYTES, "azimuth_rad": _BYTES,
        "altitude_rad": _BYTES,
    },
    "pose": {**_HEAD, "translation_m": Column(Content.VEC3, True), "rotation_xyzw": Column(Content.VEC4, True)},
    "truth_3d": _truth(Boxes3D),
    "truth_2d": _truth(Boxes2D),
    "raw": {
        "log_ns": Column(Content.UINT, True), "publish_ns": Column(Content.UINT), "sequence": _INT, "position": _INT,
        "data": _NEED_BYTES,
    },
}  # fmt: skip
"""Columns of each kind of stream by name, `log_ns` first: with it alone a log can be indexed."""
_MAX_NAME = 80
_TOPICS: Mapping[StreamKind, str] = {
    "camera": "/{}/image", "lidar": "/{}/points", "radar": "/{}/points", "pose": "/pose", "truth_2d": BOXES2D,
    "truth_3d": BOXES3D, "raw": "",
}  # fmt: skip


def arrow_schema(kind: StreamKind) -> pa.Schema:
    """Return the schema of the files that fbench writes."""
    # Boxes that are needed are null where nothing is labeled.
    nullable = BOXES_NEEDED if kind.startswith("truth") else ()
    columns = COLUMNS[kind].items()
    return pa.schema([pa.field(n, c.content.value, not c.needed or n in nullable) for n, c in columns])


def present_columns(where: str, kind: StreamKind, schema: pa.Schema) -> dict[str, Column]:
    """Return the documented columns that a file has; all others are ignored. Raises LogError where a needed one is
    missing, or one is there twice or has another type.
    """
    columns = COLUMNS[kind]
    missing = ", ".join(name for name, column in columns.items() if column.needed and name not in schema.names)
    if missing:
        raise LogError(f"{where}: stream of kind '{kind}' without column {missing}; see docs/formats.md", "PQ001")
    found = {name: column for name, column in columns.items() if name in schema.names}
    for name, column in found.items():
        if schema.names.count(name) > 1:
            raise LogError(f"{where}: column '{name}' is there twice", "PQ001")
        if not _fits(column.content.value, got := schema.field(name).type):
            raise LogError(f"{where}: column '{name}': expected {column.content.value}, got {got}", "PQ001")
    return found


def _fits(expected: pa.DataType, got: pa.DataType) -> bool:
    types = pa.types
    if types.is_nested(expected):
        lists = types.is_list(got) or types.is_large_list(got) or types.is_fixed_size_list(got)
        return lists and _fits(expected.value_type, got.value_type)
    if types.is_integer(expected):
        return bool(types.is_integer(got))
    if types.is_floating(expected):
        return bool(types.is_floating(got))
    return str(got).removeprefix("large_") == str(expected)  # `bool`, `string`, `binary`


def default_topic(kind: StreamKind, sensor: str) -> str:
    """Topic of a stream as in fbench's MCAP logs, so that canonical order is the same in both."""
    return _TOPICS[kind].format(sensor)


def file_name(topic: str, taken: Collection[str]) -> str:
    """Name for the file of a topic: plain ASCII, unlike all `taken` (in lower case) even where case doesn't count."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", ".", topic).strip("._-")[:_MAX_NAME].rstrip("._-") or "stream"
    name, number = f"{plain}.parquet", 1
    while name.lower() in taken:
        number += 1
        name = f"{plain}-{number}.parquet"
    return name
