"""Detection by all cameras of a rig, timed: from a frame to detections."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fbench.pipelines.models.weights import AUTO
from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraDetector, CameraParams
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import require_projection

CITY_WEIGHTS = Path(__file__).with_name("city.onnx")  # See `docs/detector.md`


def with_builtin(own: Mapping[str, CameraParams], log_info: LogInfo) -> dict[str, CameraParams]:
    """Return the parameters of all cameras, with the built-in weights in place of `auto` where the log is simulated."""
    if SIMULATED not in log_info.metadata:
        return dict(own)
    return {
        name: replace(params, weights=CITY_WEIGHTS) if params.weights == AUTO else params
        for name, params in own.items()
    }


def builtin_identity(own: Mapping[str, CameraParams], asked: CameraParams) -> dict[str, object]:
    """Return what the manifest says of built-in weights, where cameras use them."""
    used = [name for name, params in own.items() if params.weights == CITY_WEIGHTS]
    if asked.weights == AUTO:
        used = ["camera"] if used else []
    return {f"{name}.weights": describe_file(CITY_WEIGHTS) for name in used if asked.weights != CITY_WEIGHTS}


def look(
    detector: CameraDetector, image: Image, clock: StageClock, faults: list[Fault], share: float = 1.0
) -> CameraDetections | None:
    """Detect road users in one image; where it is corrupt, append a fault and return `None`.

    With a `share` below 1 also those that other sensors may confirm: down to that share of the camera's `min_score`.

    Timed as `decode`, `preprocess` and `detect.camera`. Raises ModelError where the model fails.
    """
    with clock.stage("decode"):
        pixels = decode(image)
    if pixels is None:
        faults.append(Fault("DEC002", f"{image.sensor} at stamp {image.stamp_ns}"))
        return None
    with clock.stage("preprocess"):
        prepared = detector.prepare(pixels)
    with clock.stage("detect.camera"):
        return detector.infer(prepared, share)


NO_WEIGHTS = "no weights"  # Why a camera for which no detector is named isn't used


class CameraStage:
    """Loads the weights that parameters name, once for all logs; those of the kind at once.

    With a `share` below 1 boxes down to that share of a camera's `min_score` are found, for other sensors to confirm.
    Raises ConfigError where the file with the weights is missing. Raises ModelError where the weights can't be used.
    """

    def __init__(self, params: CameraParams, share: float = 1.0) -> None:
        self._params, self._share, self._loaded = params, share, dict[CameraParams, CameraDetector]()
        self._load(params)
        self.used: Mapping[str, CameraDetector] = {}  # Detectors of the cameras that have weights, by their names
        self.missing: Mapping[str, str] = {}  # The other cameras of the rig, with the reason
        self.identity: Mapping[str, object] = {}  # Which weights are used, where no parameter names them

    def start(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig, each with its own parameters; see the class for what is raised.

        On simulated logs `auto` is the built-in detector.
        """
        own = with_builtin(settings.own("camera", self._params), log_info)
        found = {name: self._load(params) for name, params in own.items()}
        self._rig, self.identity, cameras = rig, builtin_identity(own, self._params), rig.sensors("camera")
        self.used = {name: detector for name in cameras if (detector := found.get(name)) is not None}
        self.missing = {name: NO_WEIGHTS for name in cameras if name not in self.used}

    def _load(self, params: CameraParams) -> CameraDetector | None:
        if not isinstance(params.weights, Path):
            return None
        if params not in self._loaded:
            self._loaded[params] = CameraDetector(params)
        return self._loaded[params]

    def require_projections(self) -> None:
        """Refuse cameras that are used where points can't be projected into their images. Raises LogError naming the
        first such camera, and why.
        """
        for name in self.used:
            require_projection(self._rig, name)

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, CameraDetections]:
        """Detect in the images of one frame, by camera in the order of their names.

        Cameras without an image in the frame are left out; so are those whose image is corrupt, which is a fault. Timed
        as `decode`, `preprocess` and `detect.camera`. Raises ModelError where a model fails.
        """
        found: dict[str, CameraDetections] = {}
        for name, detector in self.used.items():
            if isinstance(image := frame.messages.get(name), Image):
                seen = look(detector, image, clock, faults, self._share)
                if seen is not None:
                    found[name] = seen
        return found
