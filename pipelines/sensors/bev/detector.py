"""Bird's-eye networks as detectors: points in, labeled boxes out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np

from fbench.pipelines.models.weights import AUTO
from fbench.pipelines.sensors.bev.decoding import CLASSES, NUM_OUTPUTS, STRIDE, DecodingParams, decode
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, NO_RADAR, NUM_CHANNELS, SIDE, BevPoints, rasterize
from fbench.pipelines.sensors.bev.pillars import PillarDetector, PillarLayout, is_pillar_head, read_layout
from fbench.pipelines.sensors.camera.model import ORT_ERRORS, first_line, load
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.contracts.errors import ConfigError, ModelError, did_you_mean
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo
from fbench.replay.geometry.threads import num_threads

BUILTIN = Path(__file__).with_name("learned3d.onnx")  # See `docs/learned.md`
_MAX_IOU = 0.15  # Solid things don't share their place


Sensors: TypeAlias = Literal["both", "lidar", "radar"]


@dataclass(frozen=True)
class BevParams(CheckedParams, prefix="network"):
    """Parameters of the bird's-eye network."""

    name = "network"
    """How a pipeline names them"""
    weights: Literal["auto"] | Path = AUTO
    """An ONNX file made by `fbench weights train --model learned3d`, or the head of Autoware's CenterPoint; `auto`:
    fbench's own."""
    encoder: Path | None = None  # The voxel encoder that belongs to such a head.
    layout: Path | None = None
    """Its parameters, `*_ml_package.param.yaml`: range, voxel size, classes; without a file, Autoware's usual ones."""
    sensors: Sensors | None = None
    """Whose points the network gets; none: `both`, but in late3d `lidar` where the built-in network looks at a log that
    isn't simulated, whose radars it never saw. A CenterPoint looks at LiDARs alone."""
    classes: tuple[str, ...] = ()
    """Labels of the boxes that are reported, such as `car,pedestrian`; none: all that the network knows."""
    min_score: float = in_range(0.4, 0, 1)  # Boxes with a lower score are dropped.
    threads: int = in_range(2, 1)
    """Threads of onnxruntime at most, and no more than there are processors; results are the same for any number."""


@dataclass(frozen=True)
class LidarNetworkParams(BevParams, prefix="lidar.network"):
    """Parameters of the bird's-eye network in detection by LiDAR."""

    name = "lidar.network"
    min_score: float = in_range(0.1, 0, 1)
    """Boxes with a lower score don't count; whether the others are reported is decided where sensors are fused."""


class Detector(Protocol):
    """What finds boxes in points from above."""

    sensors: Sensors  # Whose points it looks at

    def detect(self, points: BevPoints, plane: Plane, least: float) -> Boxes3D:
        """Find boxes with at least the score `least` in body coordinates, by falling score; heights of points are above
        `plane`. Raises ModelError where the network fails.
        """
        ...


def open_detector(params: BevParams) -> Detector:
    """Load the network or networks. Raises ConfigError where a file is missing, or a class that is asked for isn't
    known; ModelError where a file isn't such a network.
    """
    path, threads = BUILTIN if params.weights == AUTO else params.weights, min(params.threads, num_threads())
    try:
        session = load(path, threads)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    if not is_pillar_head(session):
        if params.encoder is not None or params.layout is not None:
            raise ConfigError(
                f"{path}: isn't the head of a CenterPoint, so {params.name}.encoder and layout mean nothing"
            )
        return _Filter(BevDetector(session, path), params, CLASSES, params.sensors or "both")
    if params.encoder is None:
        raise ConfigError(f"{path}: needs the voxel encoder that belongs to it: --set {params.name}.encoder=FILE")
    if params.sensors == "radar":
        raise ConfigError(f"{path}: detects in points of LiDARs; {params.name}.sensors=radar leaves it none")
    layout = PillarLayout() if params.layout is None else read_layout(params.layout)
    pillars = PillarDetector(session, path, params.encoder, layout, threads, params.name)
    return _Filter(pillars, params, pillars.classes, "lidar")


def describe_weights(params: BevParams) -> dict[str, object]:
    """Say what the built-in network is, where it is used; of another one the parameter tells."""
    return {f"{params.name}.weights": describe_file(BUILTIN)} if params.weights == AUTO else {}


def is_of_other_world(params: BevParams, log_info: LogInfo) -> bool:
    """Whether the built-in network looks at a log that isn't simulated."""
    return params.weights == AUTO and SIMULATED not in log_info.metadata


def warn_of_other_world(params: BevParams, log_info: LogInfo) -> tuple[Fault, ...]:
    """Say where the built-in network looks at what it never saw."""
    if not is_of_other_world(params, log_info):
        return ()
    text = (
        f"{params.name}: the built-in one knows the simulated city alone; train one on logs such as this: "
        "fbench weights train LOGS --model learned3d --weights auto -o own.onnx"
    )
    return (Fault("PRD007", text),)


class _Filter:
    """Keeps the boxes of some classes."""

    def __init__(
        self, detector: "BevDetector | PillarDetector", params: BevParams, known: Sequence[str], sensors: Sensors
    ) -> None:
        self._detector, self._classes, self.sensors = detector, params.classes, sensors
        for name in params.classes:
            if name not in known:
                raise ConfigError(f"{params.name}.classes: the network knows no '{name}'{did_you_mean(name, known)}")

    def detect(self, points: BevPoints, plane: Plane, least: float) -> Boxes3D:
        boxes = self._detector.detect(points, plane, least)
        return boxes if not self._classes or boxes.label is None else boxes[np.isin(boxes.label, self._classes)]


class BevDetector:
    """Runs the network of fbench, after a trial without points, as the header doesn't tell everything. Raises
    ModelError where it is another one.
    """

    def __init__(self, session: Any, path: Path) -> None:
        self._session, self._path = session, path
        ports = [(port.name, list(port.shape[1:])) for port in session.get_inputs()]
        if ports != [("points", [NUM_CHANNELS, SIDE, SIDE])]:
            raise ModelError(
                f"{path}: not a bird's-eye network of fbench, nor the head of a CenterPoint: takes {ports}"
            )
        self.detect(BevPoints(NO_LIDAR, NO_RADAR), Plane(0.0, 0.0, 0.0), 1.0)

    def detect(self, points: BevPoints, plane: Plane, least: float) -> Boxes3D:
        """Find boxes with at least the score `least` in body coordinates, by falling score; heights of points are above
        `plane`. Raises ModelError where the network fails.
        """
        try:
            outputs = self._session.run(None, {"points": rasterize(points)[None]})
        except ORT_ERRORS as error:
            raise ModelError(f"{self._path}: the network failed ({first_line(error)})") from error
        shapes, side = [value.shape if isinstance(value, np.ndarray) else None for value in outputs], SIDE // STRIDE
        if shapes != [(1, NUM_OUTPUTS, side, side)] or not np.isfinite(outputs[0]).all():
            raise ModelError(f"{self._path}: not the output of a bird's-eye network")
        boxes = decode(outputs[0][0], DecodingParams(least, _MAX_IOU))
        center = boxes.center_m.copy()
        center[:, 2] += plane.z_m(center)
        return replace(boxes, center_m=center)
