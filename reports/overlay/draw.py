"""Boxes as Foxglove draws them: cubes with arrows in space, rectangles in images, and one line of text about each.

https://docs.foxglove.dev/docs/sdk/schemas: the origin of images is the top left corner, half a pixel from the center of
the first pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from google.protobuf.timestamp_pb2 import Timestamp
from scipy.spatial.transform import Rotation

from fbench.replay.data.boxes import Boxes, Boxes3D, Source
from fbench.replay.logs.codecs.foxglove.messages import rotation, vector
from fbench.replay.runs.tables import BoxTable
from fbench.reports.html.records import visible

_COLORS = {  # Told apart by people who don't see all colors (Okabe and Ito)
    "hit": (0.0, 0.62, 0.45), "missed": (0.8, 0.47, 0.65), "false alarm": (0.84, 0.37, 0.0),
    "invalid": (0.84, 0.37, 0.0), "ignored": (0.6, 0.6, 0.6),
    "truth": (0.9, 0.9, 0.9), "detections": (0.34, 0.71, 0.91), "tracks": (0.94, 0.89, 0.26),
}  # fmt: skip
_RANK = ("hit", "missed", "false alarm", "invalid", "ignored")
_ALPHA = {"truth": 0.2, "detections": 0.35, "tracks": 0.5}
_MAX_TEXT = 60
UPRIGHT = np.array([0.0, 0, 0, 1])
_SLOWEST_MPS = 0.1  # Of what has an arrow
_HALF_PX = 0.5


@dataclass(frozen=True, eq=False)
class Side:
    """Truth, detections or tracks of a run, with their outcomes."""

    name: str
    table: BoxTable
    outcomes: Mapping[tuple[int, str], str]
    whole: dict[int, str] = field(default_factory=dict)
    """Outcome by row, of boxes that were compared in several images the best."""

    def __post_init__(self) -> None:
        for (row, _), outcome in self.outcomes.items():
            self.whole[row] = min(self.whole.get(row, outcome), outcome, key=_RANK.index)

    def first(self, index: int) -> int:
        """Row of the first box of a frame."""
        return int(np.searchsorted(self.table.frames, index))

    def outcome(self, row: int, camera: str = "") -> str:
        """What became of a box, in an image where it was compared there; empty where nobody knows."""
        return self.outcomes.get((row, camera), self.whole.get(row, ""))

    def color(self, outcome: str, alpha: float) -> Color:
        """Color of a box."""
        r, g, b = _COLORS[outcome or self.name]
        return Color(r=r, g=g, b=b, a=alpha)


def draw_box(boxes: Boxes, at: int, row: Mapping[str, Any], side: Side, outcome: str) -> SceneEntity | None:
    """Draw a box in space: a cube with its velocity, or a ball where an image's box is so far away; `None` where nobody
    knows how far.
    """
    entity, color, opaque = SceneEntity(), side.color(outcome, _ALPHA[side.name]), side.color(outcome, 1.0)
    if isinstance(boxes, Boxes3D):
        angles = [0.0 if a is None else float(a[at]) for a in (boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad)]
        center, size = boxes.center_m[at], boxes.size_lwh_m[at]
        turn = rotation(Rotation.from_euler("ZYX", angles).as_quat())
        entity.cubes.add(pose=Pose(position=vector(center), orientation=turn), size=vector(size), color=color)
        top = center + np.array([0.0, 0.0, float(size[2]) / 2 + 0.5])
    elif "place" in row:
        center = np.array(row["place"], np.float64)
        pose = Pose(position=vector(center), orientation=rotation(UPRIGHT))
        entity.spheres.add(pose=pose, size=vector(np.full(3, 1.0)), color=color)
        top = center + np.array([0.0, 0.0, 1.0])
    else:
        return None
    velocity = np.array(row.get("velocity") or [np.nan], np.float64)
    if np.isfinite(velocity).all() and (length := float(np.hypot(*velocity))) > _SLOWEST_MPS:
        ahead = rotation(Rotation.from_euler("z", float(np.arctan2(velocity[1], velocity[0]))).as_quat())
        entity.arrows.add(
            pose=Pose(position=vector(center), orientation=ahead), shaft_length=length, shaft_diameter=0.1,
            head_length=0.4, head_diameter=0.3, color=opaque,
        )  # fmt: skip
    pose = Pose(position=vector(top), orientation=rotation(UPRIGHT))
    entity.texts.add(pose=pose, billboard=True, font_size=12, scale_invariant=True, color=opaque, text=describe(row))
    return entity


def outline_box(annotations: ImageAnnotations, rect: list[float], color: Color, text: str, stamp: Timestamp) -> None:
    """Draw a rectangle left, top, right, bottom [px] with its text above."""
    left, top, right, bottom = (value + _HALF_PX for value in rect)
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    annotations.points.add(
        timestamp=stamp, type=PointsAnnotation.LINE_LOOP, points=[{"x": x, "y": y} for x, y in corners],
        outline_color=color, thickness=2,
    )  # fmt: skip
    annotations.texts.add(
        timestamp=stamp, position={"x": left, "y": top}, text=text, font_size=12, text_color=color,
        background_color=Color(r=0, g=0, b=0, a=0.6),
    )  # fmt: skip


def describe(row: Mapping[str, Any]) -> str:
    """Return class, id, distance, speed, sources and score in one line."""
    number = {"distance": " m", "speed": " m/s"}
    parts = [one_line(row["label"]) or "object", "" if row["id"] is None else f"#{row['id']}"]
    for name, unit in number.items():
        if row.get(name) is not None and np.isfinite(row[name]):
            parts.append(f"{row[name]:.1f}{unit}")
    parts.append(_sources(row))
    if row["score"] is not None and np.isfinite(row["score"]):
        parts.append(f"{row['score']:.2f}")
    return " ".join(part for part in parts if part)


def facts(row: Mapping[str, Any]) -> dict[str, str]:
    """Return what viewers list of a box, in full precision."""
    names = {"class": "label", "id": "id", "score": "score", "distance_m": "distance", "speed_mps": "speed"}
    values = {name: row.get(key) for name, key in names.items()}
    texts = {name: one_line(str(value)) for name, value in values.items() if value is not None}
    return {**texts, "sources": _sources(row), "predicted": str(bool(row["predicted"]))}


def _sources(row: Mapping[str, Any]) -> str:
    return "".join(source.name or "" for source in Source if row["sources"] & source.value)


def plain_name(text: str) -> str:
    """Return a text from data on one line, with what acts or hides written visibly."""
    return " ".join(visible(text).split())


def one_line(text: str) -> str:
    """Return a text as `plain_name` does, shortened."""
    line = plain_name(text)
    return line if len(line) <= _MAX_TEXT else f"{line[: _MAX_TEXT - 1]}…"
