"""camera2d: a detector on every camera, and a tracker per camera."""

from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.models.weights import resolve_settings
from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraParams, CameraStage
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker2D
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Source, concatenate
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Camera2DParams(CheckedParams):
    """Parameters of `camera2d`."""

    camera: CameraParams = field(default_factory=CameraParams)  # The detector.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one camera, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class Camera2D(TrackingPipeline[Boxes2D]):
    """Boxes in the images of all cameras, from the images alone."""

    kinds = ("camera",)

    def __init__(self, params: Camera2DParams) -> None:
        super().__init__(Tracker2D(params.tracking), params.detect_every)
        self._params, self._cameras = params, CameraStage(params.camera)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all cameras of the rig; those without weights count as missing. Raises ConfigError where none has
        weights: on simulated logs the built-in ones are there. Raises LogError where the rig has no camera.
        """
        if not rig.sensors("camera"):
            raise LogError(f"log '{log_info.name}': camera2d needs a camera, and the rig has none", "CFG001")
        self._cameras.start(rig, log_info, SensorSettings(self._params, rig))
        if not self._cameras.used:
            raise ConfigError(
                "camera2d needs a detector for this log: fbench weights get deimv2-femto, then "
                "--set camera.weights=deimv2-femto (or the path of an ONNX file)"
            )
        self.missing, self.weights = self._cameras.missing, self._cameras.identity
        super().start(rig, log_info)

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
        faults = list[Fault]()
        seen = self._cameras.view(frame, clock, faults)
        none = CameraDetections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U1"))  # gives all frames the same fields
        boxes = [
            Boxes2D(
                np.full(len(found), name),
                found.xyxy_px,
                label=found.label,
                score=found.score,
                sources=np.full(len(found), Source.C, np.uint8),
            )
            for name, found in {"": none, **seen}.items()
        ]
        return Detected(concatenate(boxes), tuple(faults))
