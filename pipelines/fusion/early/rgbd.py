"""Learned early fusion: a camera's network that looks at LiDAR and radar points, too, drawn into the image; timed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fbench.pipelines.fusion.image import find_distance
from fbench.pipelines.fusion.sizes import SIZES
from fbench.pipelines.models.weights import AUTO, Weights
from fbench.pipelines.sensors.bev.stage import BevInput, BevMeasurement
from fbench.pipelines.sensors.camera.channels import ImagePoints, draw_channels, project_points
from fbench.pipelines.sensors.camera.detector import (
    CITY_WEIGHTS,
    CameraDetections,
    CameraDetector,
    CameraParams,
    Window,
)
from fbench.pipelines.sensors.camera.families import RGBD
from fbench.pipelines.sensors.camera.layouts import PAD_VALUE, Placement, Size
from fbench.pipelines.sensors.image.stage import by_camera
from fbench.pipelines.sensors.lidar.stage import LidarParams
from fbench.pipelines.sensors.parallel import Branches
from fbench.pipelines.sensors.points.grid import median
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import Compensated, RadarParams, median_rate
from fbench.pipelines.tracking.stage import Detected
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Boxes2D, Source, concatenate
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import project_body

RGBD_WEIGHTS = CITY_WEIGHTS.with_name("rgbd.onnx")  # See `docs/learned.md`


@dataclass(frozen=True)
class RgbdParams(CameraParams, prefix="rgbd"):
    """Parameters of detection in images with points; but for the weights they are those of the camera detector."""

    builtin = RGBD_WEIGHTS
    channels = RGBD
    weights: Weights = AUTO
    """An ONNX file made by `fbench weights train --model rgbd`; `auto` is fbench's own on simulated logs, and on others
    none; with `none` the camera isn't used.
    """


_INSET = 0.2  # This share of a box is left out on each side where LiDAR's points tell its depth
_NEAR_SHARE = 0.25  # Of the points on an object, as many are nearer than what counts as its near side
_FITS = 0.6  # Logarithm of the ratio of a depth to that guessed from the box's height, up to which both can be right
_NOTHING = BevMeasurement(None, np.zeros(0), None, None)
_BEFORE_M, _BEHIND_M = 2.0, 2.0  # Echoes so far before an object's near side, or behind its far side, are still on it


@dataclass(frozen=True, eq=False)
class RgbdView:
    """What one frame alone tells: the boxes, or what was measured where the ground isn't in it."""

    plane: Plane | None
    faults: tuple[Fault, ...]
    boxes: Boxes2D | None
    images: Mapping[str, Pixels] = field(default_factory=dict)
    measured: BevMeasurement = _NOTHING


class RgbdStage:
    """Runs the network on the images of all cameras, with what LiDARs and radars measured drawn into them."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, detectors: Mapping[str, CameraDetector], lidar: LidarParams,
        radar: RadarParams, settings: SensorSettings, branches: Branches,
    ) -> None:  # fmt: skip
        self._rig, self._detectors, self._branches = rig, detectors, branches
        self._input = BevInput(rig, log_info, "both", lidar, radar, settings)
        self._min_speed_mps, self._sees_ground = radar.min_speed_mps, bool(rig.sensors("lidar"))

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._input.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        self._input.note_pose(frame)

    def view(self, frame: Frame, clock: StageClock) -> RgbdView:
        """Detect in one frame, unless only earlier ones tell how the ground lies; a corrupt image is a fault, and
        counts as missing.
        """
        faults = list[Fault]()
        look = partial(self._decode, frame, faults=faults), partial(self._input.measure, frame)
        images, seen = self._branches.run(clock, *look)
        if seen.plane is None and self._sees_ground:
            return RgbdView(None, tuple(faults), None, images, seen)
        plane = seen.plane or self._input.remember(None)
        return RgbdView(seen.plane, tuple(faults), self._detect(images, seen, plane, clock))

    def detect(self, view: RgbdView, clock: StageClock) -> Detected[Boxes2D]:
        """Return the boxes of a view, in the order of frames."""
        plane, boxes = self._input.remember(view.plane), view.boxes
        if boxes is None:
            boxes = self._detect(view.images, view.measured, plane, clock)
        return Detected(boxes, view.faults)

    def _decode(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, Pixels]:
        found = dict[str, Pixels]()
        for name in self._detectors:
            if isinstance(image := frame.messages.get(name), Image):
                with clock.stage("decode"):
                    pixels = decode(image)
                if pixels is None:
                    faults.append(Fault("DEC002", f"{name} at stamp {image.stamp_ns}"))
                else:
                    found[name] = pixels
        return found

    def _detect(self, images: Mapping[str, Pixels], seen: BevMeasurement, plane: Plane, clock: StageClock) -> Boxes2D:
        parts = [_report("", CameraDetections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U1")), [])]
        for name, detector in self._detectors.items():
            with clock.stage("preprocess"):
                points, pixels = project_points(self._rig, name, seen, plane), images.get(name)
                if pixels is None and not len(points.lidar) and not len(points.radar):
                    continue
                width, height = self._rig.cameras[name].size_wh
                shown = np.full((height, width, 3), PAD_VALUE, np.uint8) if pixels is None else pixels
                prepared = detector.prepare(shown, partial(draw_window, points))
            with clock.stage("detect.network"):
                found = detector.infer(prepared)
            with clock.stage("fuse"):
                measure = Measure.of(self._rig, name, points, seen.echoes, self._min_speed_mps)
                guess = by_camera(found, self._rig.cameras[name]).depth_m
                boxes = zip(found.xyxy_px, found.label.tolist(), guess.tolist(), strict=True)
                rows = [measure.find(*box, Source.C if pixels is not None else 0) for box in boxes]
                parts.append(_report(name, found, rows))
        return concatenate(parts)


def draw_window(points: ImagePoints, window: Window, placement: Placement, input_wh: Size) -> Pixels:
    """Draw points (channels: depth, radial velocity) where a window of the image lies in the input, and nothing in the
    border around it.
    """
    left, top, right, bottom = window
    scale, offset = placement.scale[0], np.array(placement.offset)
    drawn = draw_channels(points.move(scale, np.array([left, top]) - offset / scale), input_wh)
    x, y = (int(at) for at in placement.offset)
    inner = slice(y, y + round((bottom - top) * placement.scale[1])), slice(x, x + round((right - left) * scale))
    result = np.zeros_like(drawn)
    result[inner] = drawn[inner]
    return result


@dataclass(frozen=True)
class Measured:
    """What is known of one box."""

    distance_m: float  # From the body's origin to the middle [m]; NaN where unknown
    rate_mps: float  # Change of the distance [m/s], positive when receding; NaN where unknown
    sources: int  # Bits of `Source`


@dataclass(frozen=True, eq=False)
class Measure:
    """Finds distances and range rates of boxes in one image, by the LiDAR points and echoes in them."""

    rig: Rig
    camera: str
    lidar_px: Float64  # (N, 2) [px], of what stands on the ground
    lidar_m: Float64  # (N,) depths [m]
    echo_px: Float64  # (M, 2)
    echo_m: Float64  # (M,)
    echoes: Compensated | None  # (M,)
    min_speed_mps: float  # Echoes that are slower over ground stand

    @classmethod
    def of(
        cls, rig: Rig, camera: str, points: ImagePoints, echoes: Compensated | None, min_speed_mps: float
    ) -> "Measure":
        """Take what was measured in one frame."""
        lidar = points.lidar.astype(np.float64)
        echo_px, echo_m = project_body(rig, camera, np.zeros((0, 3)) if echoes is None else echoes.xyz)
        return cls(rig, camera, lidar[:, :2] - 0.5, lidar[:, 2], echo_px, echo_m, echoes, min_speed_mps)

    def find(self, xyxy_px: Float64, label: str, guess_m: float, sources: int) -> Measured:
        """Measure what is in a box (4,), whose depth is guessed [m], or NaN. LiDAR tells the depth of its near side,
        else radar, else the guess.
        """
        size = SIZES.get(label, SIZES["car"])
        near_m = _near_side(self.lidar_m[_inside(self.lidar_px, xyxy_px, _INSET)], guess_m)
        has_points, there = not np.isnan(near_m), _inside(self.echo_px, xyxy_px, 0.0)
        near_m = near_m if has_points else _near_side(self.echo_m[there], guess_m)
        there &= (self.echo_m > near_m - _BEFORE_M) & (self.echo_m < near_m + size.length_m + _BEHIND_M)
        near_m = guess_m if np.isnan(near_m) else near_m
        # On average over headings.
        distance_m = find_distance(self.rig, self.camera, xyxy_px, near_m + (size.length_m + size.width_m) / 4)
        found = Source.L * has_points + Source.R * bool(there.any())
        return Measured(distance_m, self._rate_mps(there), int(sources | found))

    def _rate_mps(self, rows: Bool) -> float:
        """By moving echoes where there are two, else by all."""
        if self.echoes is None:
            return float("nan")
        over_ground = self.echoes.range_rate_mps
        rows = rows & np.isfinite(over_ground + self.echoes.own_mps)
        moving = rows & (np.abs(over_ground) >= self.min_speed_mps)
        rows = moving if np.count_nonzero(moving) > 1 else rows
        if not rows.any():
            return float("nan")
        return median_rate(over_ground[rows], self.echoes.period_mps[rows]) - median(self.echoes.own_mps[rows])


def _inside(uv_px: Float64, xyxy_px: Float64, inset: float) -> Bool:
    """Which pixels (N, 2) lie in a box (4,) without this share of it on each side; NaN doesn't."""
    margin = inset * (xyxy_px[2:] - xyxy_px[:2])
    inside = (uv_px >= xyxy_px[:2] + margin) & (uv_px <= xyxy_px[2:] - margin)
    return np.asarray(inside.all(axis=1), np.bool_)


def _near_side(depths_m: Float64, guess_m: float) -> float:
    """Depth [m] of the near side of an object with points (N,) in its box, some of which others may have left."""
    if not np.isnan(guess_m):
        depths_m = depths_m[np.abs(np.log(depths_m / guess_m)) < _FITS]
    if not len(depths_m):
        return float("nan")
    return float(np.sort(depths_m)[int(_NEAR_SHARE * (len(depths_m) - 1))])


def _report(camera: str, found: CameraDetections, rows: Sequence[Measured]) -> Boxes2D:
    """Boxes of one image in which something was measured."""
    boxes = Boxes2D(
        camera=np.full(len(found), camera),
        xyxy_px=found.xyxy_px,
        label=found.label,
        score=found.score,
        distance_m=np.array([row.distance_m for row in rows], np.float64),
        range_rate_mps=np.array([row.rate_mps for row in rows], np.float64),
        sources=np.array([row.sources for row in rows], np.uint8),
    )
    return boxes[np.array([row.sources > 0 for row in rows], np.bool_)]
