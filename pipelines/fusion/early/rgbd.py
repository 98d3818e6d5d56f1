"""Learned early fusion: a camera's network that looks at LiDAR and radar points, too, drawn into its image."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fbench.pipelines.fusion.early.cloud import DepthView
from fbench.pipelines.models.weights import AUTO, Weights
from fbench.pipelines.sensors.bev.stage import FLAT, BevMeasurement
from fbench.pipelines.sensors.camera.channels import ImagePoints, draw_channels, project_points
from fbench.pipelines.sensors.camera.detector import (
    CITY_WEIGHTS,
    CameraDetections,
    CameraParams,
    CameraStage,
    Window,
    decode_image,
)
from fbench.pipelines.sensors.camera.families import RGBD
from fbench.pipelines.sensors.camera.layouts import Placement, Size
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import LogInfo, Rig

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


_NOTHING = BevMeasurement(None, np.zeros(0), None, None)


@dataclass(frozen=True, eq=False)
class RgbdView:
    """What one frame alone tells: what the cameras see, or their images and the points where the ground isn't known."""

    plane: Plane | None  # The ground by LiDAR
    found: Mapping[str, CameraDetections] | None
    images: Mapping[str, Pixels] = field(default_factory=dict)
    measured: BevMeasurement = _NOTHING


class RgbdStage:
    """Detects in the images of `cameras`, with what LiDARs and radars measured drawn into them; without these, in the
    images alone. See `CameraStage` for `share` and what is raised.
    """

    def __init__(self, params: RgbdParams, share: float) -> None:
        self.cameras, self._share = CameraStage(params), share
        self.reset()

    def start(self, pipeline: str, rig: Rig, log_info: LogInfo) -> None:
        """Take the cameras, which were started. Raises LogError where there is none, ConfigError where none of them has
        weights for this log.
        """
        require(f"{pipeline} with detector=rgbd", ("camera",), rig, log_info)
        if not self.cameras.used:
            raise ConfigError(
                f"{pipeline} with detector=rgbd needs a network for this log: --set rgbd.weights=FILE.onnx"
            )
        self._rig, self._sees_ground = rig, bool(rig.sensors("lidar"))

    def reset(self) -> None:
        """Forget how the ground lies."""
        self._plane = FLAT

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, Pixels]:
        """Decode the images of one frame; a corrupt one is a fault, and counts as missing."""
        found = dict[str, Pixels]()
        for name in self.cameras.used:
            if isinstance(image := frame.messages.get(name), Image):
                pixels = decode_image(image, clock, faults)
                if pixels is not None:
                    found[name] = pixels
        return found

    def detect(
        self, images: Mapping[str, Pixels], depth: DepthView, echoes: Compensated | None, clock: StageClock
    ) -> RgbdView:
        """Detect in the images of one frame, unless only earlier ones tell how the ground lies."""
        plane = depth.lidar.plane
        seen = BevMeasurement(depth.measured, depth.lidar.every_height_m, echoes, plane)
        if plane is None and self._sees_ground:
            return RgbdView(None, None, images, seen)
        return RgbdView(plane, self._detect(images, seen, plane or FLAT, clock))

    def conclude(self, view: RgbdView, clock: StageClock) -> Mapping[str, CameraDetections]:
        """Return what a view shows, in the order of frames."""
        self._plane = view.plane or self._plane
        if view.found is not None:
            return view.found
        return self._detect(view.images, view.measured, self._plane, clock)

    def _detect(
        self, images: Mapping[str, Pixels], seen: BevMeasurement, plane: Plane, clock: StageClock
    ) -> dict[str, CameraDetections]:
        found = {}
        for name, pixels in images.items():
            detector = self.cameras.used[name]
            with clock.stage("preprocess"):
                points = project_points(self._rig, name, seen, plane)
                prepared = detector.prepare(pixels, partial(draw_window, points))
            with clock.stage("detect.network"):
                found[name] = detector.infer(prepared, self._share)
        return found


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
