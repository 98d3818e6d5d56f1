"""Messages of an overlay, a run's results on Foxglove's schemas, and the MCAP file that holds them."""

import heapq
import json
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.files import replace_text
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.logs.codecs.foxglove.messages import WORLD, rotation, vector
from fbench.replay.logs.codecs.foxglove.proto import timestamp
from fbench.replay.logs.codecs.foxglove.topics import Record
from fbench.replay.logs.container import Container, LogHeader
from fbench.replay.logs.containers.mcap.write import Encoded, RawMcapWriter, encode
from fbench.replay.logs.coordinate_frames import BODY
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.reports.boxes import box_rows
from fbench.reports.html.records import visible
from fbench.reports.overlay.draw import UPRIGHT, Side, describe, draw_box, facts, one_line, outline_box, plain_name
from fbench.reports.overlay.layout import layout

Outcomes: TypeAlias = Mapping[str, Mapping[tuple[int, str], str]]
"""Of `truth`, `truth_2d`, `detections` and `tracks`: `hit`, `missed`, `false alarm`, `ignored` or `invalid`, by the row
in that table of the run and the camera in whose image the box was compared, which is empty in 3D."""

TOPICS = "/fbench"  # What the overlay's topics begin with
_TRAIL_NS = 3_000_000_000


@dataclass(frozen=True)
class Names:
    """What the log calls coordinate frames."""

    body: str = BODY
    world: str = WORLD

    @property
    def are_own(self) -> bool:
        """Whether the log is one of fbench, whose transforms don't tell where the body is."""
        return self.body == BODY


OWN = Names()


def write_overlay(
    run: Run, outcomes: Outcomes, out: Path, log: Container | None = None, names: Names = OWN
) -> list[Path]:
    """Write the results of a run to `out`, among the messages of its `log` if that is given, and a layout for both
    beside it; return both paths. Equal runs give equal bytes. Transforms of logs with other `names` are left to them.

    Boxes are colored by `outcomes`, those without one by what they are. Text that acts or hides, such as control
    characters, is written visibly. Raises ConfigError where the file can't be written, or the log is the file itself
    or holds no encoded messages. Raises LogError where a stamp can't be stored.
    """
    if log is not None and log.path.resolve() == out.resolve():
        raise ConfigError(f"{out}: is the log itself; choose another file for the overlay")
    about = LogHeader(visible(run.manifest.log.log_id)) if log is None or log.header is None else log.header
    recorded = [] if log is None else [_copy(log)]
    writer = RawMcapWriter(out, about)
    try:
        for log_ns, message in heapq.merge(*recorded, _results(run, outcomes, names), key=lambda item: item[0]):
            writer.add(message.channel, log_ns, message.publish_ns, message.sequence, message.data)
        writer.close()
    finally:
        writer.discard()
    beside = out.with_suffix(".layout.json")
    sides = [name for name in ("truth", "detections", "tracks") if name != "truth" or _has_truth(run)]
    content = layout(_cameras(run), sides, TOPICS, plain_name(names.body), has_world=_has_world(run))
    replace_text(beside, json.dumps(content, indent=1) + "\n")
    return [out, beside]


def _copy(log: Container) -> Iterator[tuple[int, Encoded]]:
    """Yield the messages of the log as they are, with the log times."""
    for entry in log.entries(frozenset(log.channels)):
        if not isinstance(entry.data, memoryview):
            raise ConfigError(f"{log.path}: holds no messages as they were sent; fbench log convert makes MCAP of it")
        yield entry.log_ns, Encoded(log.channels[entry.channel], entry.publish_ns, entry.sequence, bytes(entry.data))


def _has_truth(run: Run) -> bool:
    return any(frame.truth_spaces for frame in run.frames)


def _has_world(run: Run) -> bool:
    return bool(np.isfinite(run.poses).all(axis=1).any())


def _cameras(run: Run) -> list[str]:
    return sorted({*run.manifest.rig.cameras, *run.manifest.images})


def _results(run: Run, outcomes: Outcomes, names: Names) -> Iterator[tuple[int, Encoded]]:
    """Yield all messages of the overlay, each at the instant of its frame."""
    sides = [Side(name, getattr(run, name), outcomes.get(name, {})) for name in ("detections", "tracks")]
    flat, solid = run.truth_table("2d"), run.truth_table("3d")
    truths = [Side("truth", flat, outcomes.get("truth_2d", {})), Side("truth", solid, outcomes.get("truth", {}))]
    truths = truths if _has_truth(run) else []
    trails, segment = _Trails(plain_name(names.world)), -1
    for number, frame in enumerate(run.frames):
        rig, stamp_ns = run.manifest.rig_of(frame.segment), frame.stamp_ns
        records = [*_notes(frame)]
        if names.are_own:
            records += _transforms(run, number, rig, is_new=frame.segment != segment)
        if frame.segment != segment:
            trails, segment = _Trails(plain_name(names.world)), frame.segment
        records += _boxes(frame, rig, [*sides, *truths], _cameras(run), plain_name(names.body))
        records += trails.add(frame, run.poses[number], sides[1])
        for record in records:
            yield stamp_ns, encode(record, stamp_ns)


def _transforms(run: Run, number: int, rig: Rig, *, is_new: bool) -> Iterator[Record]:
    """Place the body in the world, and where the rig is new the sensors on the body."""
    frame, pose = run.frames[number], run.poses[number]
    placed = [(WORLD, BODY, pose[:3], pose[3:])] if np.isfinite(pose).all() else []
    if is_new:
        placed += [(BODY, plain_name(name), m.translation_m, m.rotation_xyzw) for name, m in sorted(rig.mounts.items())]
    proto, stamp = FrameTransforms(), timestamp(frame.stamp_ns)
    for parent, child, place, turn in placed:
        proto.transforms.add(
            timestamp=stamp, parent_frame_id=parent, child_frame_id=child, translation=vector(place),
            rotation=rotation(turn),
        )  # fmt: skip
    if proto.transforms:
        yield Record(f"{TOPICS}/transforms", {}, proto)


def _notes(frame: FrameRecord) -> Iterator[Record]:
    """Say which sensors a frame lacked, and why it failed."""
    texts = [(Log.WARNING, f"{sensor} is missing: {why}") for sensor, why in sorted(frame.missing.items())]
    texts += [(Log.ERROR, f"pipeline failed: {frame.failed}")] if frame.failed is not None else []
    texts += [(Log.WARNING, "dropped: the pipeline was busy")] if frame.is_dropped else []
    for level, text in texts:
        note = Log(
            timestamp=timestamp(frame.stamp_ns), level=level, name=f"frame {frame.index}", message=one_line(text)
        )
        yield Record(f"{TOPICS}/log", {}, note)


def _boxes(frame: FrameRecord, rig: Rig, sides: list[Side], cameras: list[str], body: str) -> Iterator[Record]:
    """Draw the boxes of all sides, in space and in each camera; empty messages remove what was there."""
    scenes = {side.name: SceneUpdate() for side in sides}
    images = {(side.name, camera): ImageAnnotations() for side in sides for camera in cameras}
    calibrated = [name for name in sorted(rig.cameras) if name in rig.mounts]
    stamp = timestamp(frame.stamp_ns)
    # Where images have truth of their own it counts there, and 3D truth in space alone.
    in_images = "2d" in frame.truth_spaces.split()
    for side in sides:
        boxes, first = side.table.at(frame.index), side.first(frame.index)
        only_space = in_images and side.name == "truth" and isinstance(boxes, Boxes3D)
        for at, row in enumerate(box_rows(boxes, rig, [] if only_space else calibrated)):
            outcome, scene = side.outcome(first + at), scenes[side.name]
            entity = None if row.get("invalid") else draw_box(boxes, at, row, side, outcome)
            if entity is not None:
                entity.id, entity.frame_id = f"{side.name} {len(scene.entities)}", body
                entity.timestamp.CopyFrom(stamp)
                for key, value in (facts(row) | {"outcome": outcome, "row": str(first + at)}).items():
                    entity.metadata.add(key=key, value=value)
                scene.entities.append(entity)
            for camera, outline in sorted(row["seen"].items()):
                if (side.name, camera) in images:
                    color = side.color(side.outcome(first + at, camera), 1.0)
                    outline_box(images[side.name, camera], outline["rect"], color, describe(row), stamp)
    for name, scene in scenes.items():
        scene.deletions.add(type=SceneEntityDeletion.ALL, timestamp=stamp)  # what the frame before drew
        yield Record(f"{TOPICS}/{name}", {}, scene)
    for (name, camera), annotations in images.items():
        annotations.timestamp.CopyFrom(stamp)
        yield Record(f"{TOPICS}/{name}/{plain_name(camera)}", {}, annotations)


class _Trails:
    """Where tracks were in the last seconds, in world coordinates."""

    def __init__(self, world: str) -> None:
        self._world = world
        self._places: dict[int, deque[tuple[int, Any]]] = {}

    def add(self, frame: FrameRecord, pose: Any, side: Side) -> Iterator[Record]:
        """Take the tracks of a frame and draw all trails."""
        boxes, first = side.table.at(frame.index), side.first(frame.index)
        if not isinstance(boxes, Boxes3D) or boxes.track_id is None or not np.isfinite(pose).all():
            return
        scene, stamp = SceneUpdate(), timestamp(frame.stamp_ns)
        scene.deletions.add(type=SceneEntityDeletion.ALL, timestamp=stamp)
        world = transform(pose_matrix(pose[:3], pose[3:]), boxes.center_m)
        for at, track_id in enumerate(boxes.track_id.tolist()):
            if track_id < 0 or not np.isfinite(world[at]).all():
                continue
            places = self._places.setdefault(track_id, deque())
            places.append((frame.stamp_ns, world[at]))
            while places[0][0] < frame.stamp_ns - _TRAIL_NS:
                places.popleft()
            line = LinePrimitive(
                type=LinePrimitive.LINE_STRIP, thickness=2, scale_invariant=True,
                pose=Pose(position=vector(np.zeros(3)), orientation=rotation(UPRIGHT)),
                color=side.color(side.outcome(first + at), 0.8),
                points=[Point3(x=x, y=y, z=z) for x, y, z in (place.tolist() for _, place in places)],
            )  # fmt: skip
            scene.entities.add(id=f"trail {at}", frame_id=self._world, timestamp=stamp, lines=[line])
        yield Record(f"{TOPICS}/trails", {}, scene)
