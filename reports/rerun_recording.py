"""A run as a Rerun recording (`.rrd`): boxes, images and points over frames and stamps, for the Rerun viewer."""

import importlib
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import ConfigError, MissingPackageError, output_error
from fbench.replay.data.boxes import Boxes3D, finite
from fbench.replay.data.files import Draft
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.iou import corners
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.runs.media import MediaFrame
from fbench.replay.runs.outcomes import load_outcomes
from fbench.reports.boxes import box_rows
from fbench.reports.html.records import visible
from fbench.reports.overlay.draw import Side, describe

_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
_HALF_PX = 0.5  # Rerun's pixels begin at the corner, ours at the center of the first


def import_rerun() -> Any:
    """Import the package. Raises MissingPackageError without it."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise MissingPackageError("needs rerun-sdk; pip install 'fbench[rerun]'") from error


def write_recording(run: Run, out: Path) -> Path:
    """Write a run as a Rerun recording, which appears only when whole, and return its path. Boxes are drawn as
    wireframes in `world/body`, and in images as rectangles; colors are those of the overlay. Rerun adds random ids and
    the time of writing, so equal runs give equal content, not equal bytes.

    Raises MissingPackageError without rerun-sdk; ConfigError where the file can't be written or its name doesn't end in
    .rrd; RunError where the run is damaged.
    """
    if out.suffix != ".rrd":
        raise ConfigError(f"{out}: a Rerun recording ends in .rrd")
    rerun = import_rerun()
    manifest = run.manifest
    name = uuid.uuid5(uuid.NAMESPACE_URL, f"{manifest.log.log_id} {manifest.digest}")
    recording = rerun.RecordingStream(f"fbench {visible(manifest.pipeline)}", recording_id=name)
    try:
        with Draft(out) as draft:
            recording.save(draft.path)
            _Writer(rerun, recording, run).write()
            recording.flush()
            recording.disconnect()
            draft.publish()
    except OSError as error:
        raise output_error(out, error) from error
    return out


class _Writer:
    def __init__(self, rerun: Any, recording: Any, run: Run) -> None:
        self.rerun, self.recording, self.run = rerun, recording, run
        found = load_outcomes(run.folder)
        sides = [Side(name, getattr(run, name), found.get(name, {})) for name in ("detections", "tracks")]
        truths = [("2d", "truth_2d"), ("3d", "truth")]
        sides += [Side("truth", run.truth_table("2d" if s == "2d" else "3d"), found.get(n, {})) for s, n in truths]
        self.sides = [side for side in sides if len(side.table.frames)]
        self.media = {kept.index: kept for kept in run.media}

    def log(self, parts: Sequence[str], what: Any) -> None:
        self.recording.log([visible(part) for part in parts], what)

    def write(self) -> None:
        """Write all frames."""
        self.recording.log("world", self.rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for number, frame in enumerate(self.run.frames):
            rig = self.run.manifest.rig_of(frame.segment)
            self.recording.set_time("frame", sequence=frame.index)
            self.recording.set_time("stamp", timestamp=np.datetime64(frame.stamp_ns, "ns"))
            pose, kept = self.run.poses[number], self.media.get(frame.index, MediaFrame(frame.index))
            if np.isfinite(pose).all():
                turn = self.rerun.Quaternion(xyzw=pose[3:])
                self.log(["world", "body"], self.rerun.Transform3D(translation=pose[:3], quaternion=turn))
            scales = self._media(rig, kept)
            for side in self.sides:
                self._boxes(frame, rig, side, scales)

    def _media(self, rig: Rig, kept: MediaFrame) -> dict[str, float]:
        """Write cameras, images and points; returns how pictures are scaled, by camera."""
        rerun, scales = self.rerun, dict[str, float]()
        for name, picture in sorted(kept.pictures.items()):
            self.log(["world", "body", name], rerun.EncodedImage(contents=picture.jpeg, media_type="image/jpeg"))
        for name, camera in sorted(rig.cameras.items()):
            size = kept.pictures[name].size_wh if name in kept.pictures else camera.size_wh
            scale = scales[name] = size[0] / camera.size_wh[0]
            if name not in rig.mounts:
                continue
            body_T_camera = rig.body_T_sensor(name)
            where = rerun.Transform3D(translation=body_T_camera[:3, 3], mat3x3=body_T_camera[:3, :3])
            self.log(["world", "body", name], where)
            K = np.diag([scale, scale, 1.0]) @ camera.K
            self.log(["world", "body", name], rerun.Pinhole(image_from_camera=K, resolution=size))
        for name, points in sorted(kept.points.items()):
            self.log(["world", "body", name], rerun.Points3D(points.xyz))
        return scales

    def _boxes(self, frame: FrameRecord, rig: Rig, side: Side, scales: dict[str, float]) -> None:
        """Write the boxes of one side; none removes those of the frame before."""
        boxes, first, rerun = side.table.at(frame.index), side.first(frame.index), self.rerun
        rows = box_rows(boxes, rig, [])
        colors = [self._color(side, first + at) for at in range(len(rows))]
        if isinstance(boxes, Boxes3D):
            drawn = np.flatnonzero(finite(boxes)[0])
            lines = np.zeros((0, 2, 3)) if not len(drawn) else corners(boxes[drawn])[:, _EDGES].reshape(-1, 2, 3)
            every = [colors[at] for at in drawn for _ in _EDGES]
            self.log(["world", "body", side.name], rerun.LineStrips3D(lines, colors=every))
            centers = boxes.center_m[drawn]
            texts = [describe(rows[at]) for at in drawn]
            named = rerun.Points3D(centers, labels=texts, colors=[colors[at] for at in drawn])
            self.log(["world", "body", side.name, "names"], named)
            return
        for name, scale in sorted(scales.items()):
            at = [i for i, row in enumerate(rows) if name in row["seen"]]
            rects = [[(v + _HALF_PX) * scale for v in rows[i]["seen"][name]["rect"]] for i in at]
            drawn_2d = rerun.Boxes2D(
                array=np.array(rects).reshape(-1, 4), array_format=rerun.Box2DFormat.XYXY,
                colors=[colors[i] for i in at], labels=[describe(rows[i]) for i in at],
            )  # fmt: skip
            self.log(["world", "body", name, side.name], drawn_2d)

    def _color(self, side: Side, row: int) -> list[int]:
        color = side.color(side.outcome(row), 1.0)
        return [round(255 * part) for part in (color.r, color.g, color.b)]
