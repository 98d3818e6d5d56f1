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
    def nested(self) -> bool:
        """Whether a row holds more than one value."""
        return bool(pa.types.is_nested(self.value))


@dataclass(frozen=True)
class Column:
    """One column; those that aren't needed may be absent from the files of others."""

    content: Content
    needed: bool = False


_NEED_INT = Column(Content.INT, True)
_BYTES = Column(Content.BYTES)
_HEAD = {
    "log_ns": _NEED_INT, "stamp_ns": _NEED_INT, "frame_number": Column(Content.INT), "position": Column(Content.INT),
}  # fmt: skip
_POINTS = {**_HEAD, "num_points": Column(Content.INT), "xyz": Column(Content.BYTES, True)}
_BOX_CONTENT = {
    "center_m": Content.VECS3, "size_lwh_m": Content.VECS3, "velocity_mps": Content.VECS3, "xyxy_px": Content.VECS4,
    "visible_xyxy_px": Content.VECS4, "camera": Content.TEXTS, "label": Content.TEXTS, "attribute": Content.TEXTS,
    "source_label": Content.TEXTS, "track_id": Content.INTS, "num_lidar_pts": Content.INTS,
    "num_radar_pts": Content.INTS, "sources": Content.SMALL, "predicted": Content.FLAGS, "ignore": Content.FLAGS,
}  # fmt: skip
BOXES_NEEDED = ("center_m", "size_lwh_m", "yaw_rad", "camera", "xyxy_px")  # Null where nothing is labeled


def _boxes(kind: type[Boxes2D] | type[Boxes3D]) -> dict[str, Column]:
    names = [f.name for f in fields(kind)]
    return {name: Column(_BOX_CONTENT.get(name, Content.FLOATS), name in BOXES_NEEDED) for name in names}


_TRUTH = {**_HEAD, "expects_2d": Column(Content.FLAG), "frame_id": Column(Content.TEXT)}
COLUMNS: Mapping[StreamKind, Mapping[str, Column]] = {
    "camera": {
        **_HEAD, "encoding": Column(Content.TEXT, True), "width": _NEED_INT, "height": _NEED_INT,
        "data": Column(Content.BYTES, True),
    },
    "lidar": {**_POINTS, "intensity": _BYTES, "ring": _BYTES, "offset_ns": _BYTES},
    "radar": {
        **_POINTS, "radial_velocity_mps": _BYTES, "rcs_dbsm": _BYTES, "range_m": _BYTES, "azimuth_rad": _BYTES,
        "altitude_rad": _BYTES,
    },
    "pose": {**_HEAD, "translation_m": Column(Content.VEC3, True), "rotation_xyzw": Column(Content.VEC4, True)},
    "truth_3d": {**_TRUTH, **_boxes(Boxes3D)},
    "truth_2d": {**_TRUTH, **_boxes(Boxes2D)},
    "raw": {
        "log_ns": Column(Content.UINT, True), "publish_ns": Column(Content.UINT), "sequence": Column(Content.INT),
        "position": Column(Content.INT), "data": Column(Content.BYTES, True),
    },
}  # fmt: skip
"""Columns of each kind of stream by name, `log_ns` first: with it alone a log can be indexed."""


def arrow_schema(kind: StreamKind) -> pa.Schema:
    """Return the schema of the files that fbench writes."""
    return pa.schema([pa.field(n, c.content.value, not _always(kind, n)) for n, c in COLUMNS[kind].items()])


def _always(kind: StreamKind, name: str) -> bool:
    # Boxes that are needed are null where nothing is labeled.
    return COLUMNS[kind][name].needed and not (kind.startswith("truth") and name in BOXES_NEEDED)


def present_columns(where: str, kind: StreamKind, schema: pa.Schema) -> dict[str, Column]:
    """Return the documented columns that a file has; all others are ignored. Raises LogError where a needed one is
    missing, or one is there twice or has another type.
    """
    columns = COLUMNS[kind]
    missing = [name for name, column in columns.items() if column.needed and name not in schema.names]
    if missing:
        raise LogError(
            f"{where}: stream of kind '{kind}' without column {', '.join(missing)}; see docs/formats.md", "PQ001"
        )
    found = {name: column for name, column in columns.items() if name in schema.names}
    for name, column in found.items():
        if schema.names.count(name) > 1:
            raise LogError(f"{where}: column '{name}' is there twice", "PQ001")
        if not _fits(column.content.value, schema.field(name).type):
            got = schema.field(name).type
            raise LogError(f"{where}: column '{name}': expected {column.content.value}, got {got}", "PQ001")
    return found


def _fits(expected: pa.DataType, got: pa.DataType) -> bool:
    types = pa.types
    if types.is_nested(expected):
        lists = types.is_list(got) or types.is_large_list(got) or types.is_fixed_size_list(got)
        return lists and _fits(expected.value_type, got.value_type)
    same = {
        "int": types.is_integer, "bool": types.is_boolean, "double": types.is_floating,
        "string": lambda t: types.is_string(t) or types.is_large_string(t),
        "binary": lambda t: types.is_binary(t) or types.is_large_binary(t),
    }  # fmt: skip
    kind = "int" if types.is_integer(expected) else str(expected)
    return bool(same[kind](got))


_MAX_NAME = 80


def default_topic(kind: StreamKind, sensor: str) -> str:
    """Topic of a stream as in fbench's MCAP logs, so that canonical order is the same in both."""
    match kind:
        case "camera":
            return f"/{sensor}/image"
        case "lidar" | "radar":
            return f"/{sensor}/points"
        case "pose":
            return "/pose"
        case "truth_2d":
            return BOXES2D
        case "truth_3d":
            return BOXES3D
        case "raw":
            return ""


def file_name(topic: str, taken: Collection[str]) -> str:
    """Return a name for the file of a topic: plain ASCII, different from those `taken` even where case doesn't count.

    `taken` holds names in lower case.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]+", ".", topic).strip("._-")[:_MAX_NAME].rstrip("._-") or "stream"
    name, number = f"{plain}.parquet", 1
    while name.lower() in taken:
        number += 1
        name = f"{plain}-{number}.parquet"
    return name
