"""The bird's-eye network as a detector: points in, labeled boxes out."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fbench.pipelines.models.weights import AUTO
from fbench.pipelines.sensors.bev.decoding import CLASSES, NUM_OUTPUTS, STRIDE, DecodingParams, decode
from fbench.pipelines.sensors.bev.grid import NUM_CHANNELS, SIDE, BevPoints, rasterize
from fbench.pipelines.sensors.camera.model import ORT_ERRORS, first_line, load
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.contracts.errors import ConfigError, ModelError, did_you_mean
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.threads import num_threads

BUILTIN = Path(__file__).with_name("learned3d.onnx")  # See `docs/learned.md`
_MAX_IOU = 0.15  # Solid things don't share their place


@dataclass(frozen=True)
class BevParams(CheckedParams, prefix="network"):
    """Parameters of the bird's-eye network."""

    weights: Literal["auto"] | Path = AUTO
    """An ONNX file made by `fbench weights train --model learned3d`; `auto` is the built-in one."""
    sensors: Literal["both", "lidar", "radar"] = "both"  # Whose points the network gets.
    classes: tuple[str, ...] = ()
    """Labels of the boxes that are reported, such as `car,pedestrian`; none: all that the network knows."""
    min_score: float = in_range(0.4, 0, 1)  # Boxes with a lower score are dropped.
    threads: int = in_range(2, 1)
    """Threads of onnxruntime at most, and no more than there are processors; results are the same for any number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.classes:
            if name not in CLASSES:
                raise ConfigError(f"network.classes: the network knows no '{name}'{did_you_mean(name, CLASSES)}")


class BevDetector:
    """Runs the network. Raises ConfigError where the file is missing, ModelError where it isn't such a network."""

    def __init__(self, params: BevParams) -> None:
        self._path = BUILTIN if params.weights == AUTO else params.weights
        self._params = params
        try:
            self._session = load(self._path, min(params.threads, num_threads()))
        except ModelError as error:
            raise ModelError(f"{self._path}: {error}") from error
        ports = [(port.name, list(port.shape[1:])) for port in self._session.get_inputs()]
        if ports != [("points", [NUM_CHANNELS, SIDE, SIDE])]:
            raise ModelError(f"{self._path}: not a bird's-eye network of fbench: it takes {ports}")

    def detect(self, points: BevPoints, plane: Plane, least: float) -> Boxes3D:
        """Find boxes with at least the score `least` in body coordinates, by falling score; heights of points are above
        `plane`. Raises ModelError where the network fails.
        """
        try:
            (output,) = self._session.run(None, {"points": rasterize(points)[None]})
        except ORT_ERRORS as error:
            raise ModelError(f"{self._path}: the network failed ({first_line(error)})") from error
        if output.shape != (1, NUM_OUTPUTS, SIDE // STRIDE, SIDE // STRIDE) or not np.isfinite(output).all():
            raise ModelError(f"{self._path}: not the output of a bird's-eye network")
        boxes = decode(output[0], DecodingParams(least, _MAX_IOU))
        if self._params.classes and boxes.label is not None:
            boxes = boxes[np.isin(boxes.label, self._params.classes)]
        center = boxes.center_m.copy()
        center[:, 2] += plane.z_m(center)
        return replace(boxes, center_m=center)
