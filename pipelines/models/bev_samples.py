"""Points and truth of a training of the bird's-eye network."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fbench.pipelines.models.measured_logs import MeasuredFrame, measure_log
from fbench.pipelines.models.samples import by_kind, gather
from fbench.pipelines.models.settings import LoopSettings
from fbench.pipelines.sensors.bev.decoding import CLASSES
from fbench.pipelines.sensors.bev.grid import REACH_M, SLICES_M, BevPoints
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.merged import viewpoint
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog, StagedFaults
from fbench.replay.data.arrays import Bool, Float32, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import can_project, project_body
from fbench.replay.geometry.kernels import kernel

Sensors = Literal["both", "lidar", "radar"]


@dataclass(frozen=True)
class BevSettings(LoopSettings):
    """Parameters of a training of the bird's-eye network."""

    steps: int = 2443
    batch: int = 12  # Frames
    learning_rate: float = 2.0e-3
    sensors: tuple[float, float, float] = (0.5, 0.35, 0.15)  # Shares of views of both, of LiDAR and of radar alone
    turned: float = 0.5  # Share of views that are turned about the body's origin
    turn_rad: float = 0.6  # Largest turn to either side
    scale: float = 0.05  # Largest relative change of all lengths and speeds
    shift_m: float = 0.1  # Largest change of all heights
    thinned: float = 0.5  # Share of views from which LiDAR's channels or points are dropped
    bands: tuple[int, ...] = (2, 3, 4, 5, 6, 8)  # Of these many neighboring channels, one is kept
    band_rad: float = 0.0069  # Between neighboring channels
    least_kept: float = 0.2  # Least share of points that are kept
    cluttered: float = 0.8  # Share of views to which things are added that stand around, such as bushes and fences
    clutter: float = 15.0  # Mean number of such things in a view
    least_points: int = 3  # With fewer points of LiDAR, and fewer than 2 standing echoes, nobody need find an object


@dataclass(frozen=True, eq=False)
class BevSample:
    """One frame and the G boxes around it."""

    name: str  # Log with its id, and stamp
    points: BevPoints
    eye: Float32  # (3,) where the LiDARs are: x, y, height [m]
    boxes: Float32  # (G, 9) x, y, height of the middle above ground, length, width, height, yaw, velocity along x and y
    class_id: Int64  # (G,) index in `CLASSES`; -1 of what is neither to be found nor a mistake
    is_recorded: bool = False  # Not simulated


def bev_samples(logs: Sequence[Path], threads: int, faults: FaultLog) -> list[BevSample]:
    """Read all frames of logs that have 3D truth; what is wrong with their data is counted in `faults`. Raises LogError
    where there are none, or nothing is to be found, such as where no box holds points.
    """
    with ThreadPoolExecutor(threads, "fbench-logs") as pool:
        found = gather(pool.map(_read_log, logs), faults)
    least = BevSettings.least_points
    for where, own in by_kind(found):
        if not any((sample.class_id >= 0).any() for sample in own):
            raise LogError(f"no frame with 3D truth labeled {', '.join(CLASSES)} in {where}: nothing to learn from")
        if not any((judge_boxes(one.points, one.boxes, one.class_id, least).class_id >= 0).any() for one in own):
            raise LogError(
                f"no 3D truth in {where} holds points or echoes: nothing to learn from; is the calibration right?"
            )
    return found


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of one frame around the vehicle."""

    stamp_ns: int
    rig: Rig
    points: BevPoints
    plane: Plane


def _keep_points(of: MeasuredFrame) -> _Points:
    return _Points(of.frame.stamp_ns, of.rig, _crop(of.points), of.plane)


def _read_log(path: Path) -> tuple[list[BevSample], StagedFaults]:
    faults, found = StagedFaults(), list[BevSample]()
    info, frames = measure_log(path, "learned3d", _keep_points, faults)
    labeled = [(kept, truth.boxes3d) for kept, truth in frames if truth.boxes3d is not None]
    only_in_view = all(_in_view(kept.rig, boxes.center_m, 0.1).all() for kept, boxes in labeled)
    for kept, truth in labeled:
        rig, points, plane = kept.rig, kept.points, kept.plane
        eyes = [rig.body_T_sensor(name)[2, 3] for name in rig.sensors("lidar")]
        eye = np.array([*viewpoint(rig, "lidar")[:2], np.mean(eyes) - plane.height_m if eyes else 0.0])
        center = truth.center_m.copy()
        center[:, 2] -= plane.z_m(center)
        boxes, ids = make_rows(replace(truth, center_m=center))
        near = np.abs(boxes[:, :2]).max(axis=1, initial=0) < REACH_M + 5
        name = f"{info.name} {info.log_id} {kept.stamp_ns}"
        if only_in_view and _cameras(rig):  # only what they see was labeled
            points = BevPoints(*(part[_in_view(rig, part[:, :3], 0.0)] for part in (points.lidar, points.radar)))
        is_recorded = SIMULATED not in info.metadata
        found.append(BevSample(name, points, eye.astype(np.float32), boxes[near], ids[near], is_recorded))
    return found, faults


def _cameras(rig: Rig) -> list[str]:
    return [name for name in sorted(rig.cameras) if can_project(rig, name)]


def _in_view(rig: Rig, xyz: Float64 | Float32, margin: float) -> Bool:
    """Tell which points (N, 3) lie between the left and right edges of an image, or beside by a share of its width."""
    inside = np.zeros(len(xyz), np.bool_)
    for name in _cameras(rig):
        wide, u = rig.cameras[name].size_wh[0], project_body(rig, name, xyz)[0][:, 0]
        inside |= (u > -margin * wide) & (u < (1 + margin) * wide)
    return inside


def _crop(points: BevPoints) -> BevPoints:
    """Leave out what is never drawn, however it is turned and scaled."""
    kept = [(np.abs(rows[:, :2]) < 1.45 * REACH_M).all(axis=1) for rows in (points.lidar, points.radar)]
    height = points.lidar[:, 2]
    kept[0] &= (height > SLICES_M[0] - 0.5) & (height < SLICES_M[-1] + 0.5)
    return BevPoints(points.lidar[kept[0]], points.radar[kept[1]])


def make_rows(boxes: Boxes3D) -> tuple[Float32, Int64]:
    """Rows (G, 9) and classes (G,) of boxes whose z is above ground; see `BevSample`."""
    ids = np.full(len(boxes), -1)
    if boxes.label is not None:
        for index, label in enumerate(CLASSES):
            ids[boxes.label == label] = index
        ids[boxes.label == "trailer"] = CLASSES.index("truck")
    if boxes.ignore is not None:
        ids[boxes.ignore] = -1
    velocity = np.full((len(boxes), 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps
    columns = boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, velocity[:, :2]
    return np.column_stack(columns).astype(np.float32), ids.astype(np.int64)


@kernel
def count_inside(points: Float32, boxes: Float32, margin_m: float, bottom_m: float) -> Int64:
    """Count the points (N, 3 or more) in each box (G, 9) widened by a margin, and at least `bottom_m` high: (G,)."""
    result = np.zeros(len(boxes), np.int64)
    for g in range(len(boxes)):
        c, s = np.cos(boxes[g, 6]), np.sin(boxes[g, 6])
        top = boxes[g, 2] + boxes[g, 5] / 2 + margin_m
        for i in range(len(points)):
            x, y = points[i, 0] - boxes[g, 0], points[i, 1] - boxes[g, 1]
            if (
                abs(c * x + s * y) < boxes[g, 3] / 2 + margin_m
                and abs(c * y - s * x) < boxes[g, 4] / 2 + margin_m
                and bottom_m < points[i, 2] < top
            ):
                result[g] += 1
    return result


@dataclass(frozen=True, eq=False)
class BevView:
    """An input of the network and what is in it."""

    points: BevPoints
    boxes: Float32  # (G, 9)
    class_id: Int64  # (G,); -1 is ignored
    is_speed_known: Int64  # (G,) 1 where an echo tells


_MARGIN_M = 0.15
_LEAST_ECHOES = 2


def judge_boxes(points: BevPoints, boxes: Float32, class_id: Int64, least_points: int) -> BevView:
    """Ignore objects of which next to nothing is seen, and tell whose speed can be known."""
    seen = count_inside(points.lidar, boxes, _MARGIN_M, 0.15)
    echoes = count_inside(points.radar, boxes, _MARGIN_M, 0.15)
    ids = np.where((seen >= least_points) | (echoes >= _LEAST_ECHOES), class_id, -1)
    known = (echoes > 0) & np.isfinite(boxes[:, 7])
    return BevView(points, np.nan_to_num(boxes), ids, known.astype(np.int64))
