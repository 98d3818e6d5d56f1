"""Contents of a page: compressed, each once, and what it can do without left out."""

import base64
import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fbench.replay.data.boxes import Boxes, Boxes3D
from fbench.replay.runs.media import Points, pack_points, thin
from fbench.reports.html.records import round_floats

_NUMBERS = ("id", "score", "distance", "speed")
_PLAIN = (*_NUMBERS, "label", "sources", "predicted", "ignore", "invalid", "velocity", "place")


@dataclass(frozen=True)
class Store:
    """Contents in base64, each once, that the page refers to by number and decodes when it shows them."""

    entries: dict[str, int] = field(default_factory=dict)

    def add(self, content: bytes) -> int:
        """Return the number of a content."""
        return self.entries.setdefault(base64.b64encode(content).decode("ascii"), len(self.entries))

    def cost(self, contents: Sequence[bytes]) -> int:
        """Return what contents would add to the file."""
        texts = {base64.b64encode(content).decode("ascii") for content in contents}
        return sum(len(text) + 1 for text in texts if text not in self.entries)

    @property
    def num_bytes(self) -> int:
        """What it takes in the file."""
        return sum(map(len, self.entries)) + len(self.entries)

    @property
    def text(self) -> str:
        """One entry a line."""
        return "\n".join(self.entries)


def pack_cloud(points: Points, most: int, packed: dict[bytes, bytes]) -> bytes:
    """Return points compressed, column by column; equal ones, as of several runs of a log, are compressed once."""
    table = pack_points(thin(points, most))
    if table not in packed:
        packed[table] = _deflate(np.frombuffer(table, "<i2").reshape(-1, 4).T.tobytes())
    return packed[table]


def _deflate(content: bytes) -> bytes:
    squeeze = zlib.compressobj(6, zlib.DEFLATED, -15)
    return squeeze.compress(content) + squeeze.flush()


def deflate_json(content: Any) -> bytes:
    """Return JSON, raw deflate."""
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return _deflate(text.encode("utf-8", "replace"))


def compact_boxes(boxes: Boxes, rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Leave out what the page can do without: empty values, corners (it has center, size and angles), and rectangles
    around wires.
    """
    solid: list[list[float]] = []
    if isinstance(boxes, Boxes3D) and len(boxes):
        angles = [np.zeros(len(boxes)) if a is None else a for a in (boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad)]
        solid = np.column_stack([boxes.center_m, boxes.size_lwh_m, *angles]).tolist()
    for at, row in enumerate(rows):
        box = {name: round_floats(row[name]) for name in _PLAIN if row.get(name) or (name in _NUMBERS and name in row)}
        box = {name: value for name, value in box.items() if value is not None}
        if "corners" in row:
            box["box"] = [*(round(v, 2) for v in solid[at][:6]), *(round(v, 3) for v in solid[at][6:])]
        if seen := row["seen"]:
            box["seen"] = {name: _outline(outline) for name, outline in seen.items()}
        yield box


def _outline(outline: dict[str, Any]) -> Any:
    if outline.get("curves"):
        return {"rect": outline["rect"], "curves": [[round(v) for v in edge] for edge in outline["curves"]]}
    wire = outline["wire"]
    return [round(v) for v in wire] if wire else outline["rect"]
