"""Detection by all cameras of a rig, timed: from a frame to what they see."""

from collections.abc import Mapping

from fbench.pipelines.camera.detector import CameraDetections, CameraParams
from fbench.pipelines.camera.detectors import CameraDetectors
from fbench.pipelines.camera.look import look
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Fault, Frame, Image, LogInfo, Rig
from fbench.replay.geometry.camera import require_projection
from fbench.replay.sensor_settings import SensorSettings

NO_WEIGHTS = "no weights"
"""Why a camera for which no detector is named isn't used."""


class CameraStage:
    """Loads the weights that parameters name, once for all logs.

    With a `share` below 1 boxes down to that share of a camera's `min_score` are found, for other sensors to confirm.

    Raises:
        ConfigError: where the file with the weights is missing.
        ModelError: where the weights can't be used.
    """

    def __init__(self, params: CameraParams, share: float = 1.0) -> None:
        self._params, self._detectors, self._share = params, CameraDetectors(params), share
        self.used: tuple[str, ...] = ()
        """Names of the cameras that have weights, in order."""
        self.missing: Mapping[str, str] = {}
        """The other cameras of the rig, with the reason."""

    @property
    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._detectors.identity

    def start(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig, each with its own parameters; see the class for what is raised."""
        self._rig, cameras = rig, rig.sensors("camera")
        self._detectors.assign(settings.own("camera", self._params), log_info)
        self.used = tuple(name for name in cameras if self._detectors.of(name) is not None)
        self.missing = {name: NO_WEIGHTS for name in cameras if name not in self.used}

    def require_projections(self) -> None:
        """Refuse cameras that are used where points can't be projected into their images.

        Raises:
            LogError: naming the first such camera, and why.
        """
        for name in self.used:
            require_projection(self._rig, name)

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, CameraDetections]:
        """Detect in the images of one frame, by camera in the order of their names.

        Cameras without an image in the frame are left out; so are those whose image is corrupt, which is a fault.
        Timed as `decode`, `preprocess` and `detect.camera`.

        Raises:
            ModelError: where a model fails.
        """
        found: dict[str, CameraDetections] = {}
        for name in self.used:
            image, detector = frame.messages.get(name), self._detectors.of(name)
            if detector is None or not isinstance(image, Image):
                continue
            seen = look(detector, image, clock, faults, self._share)
            if seen is not None:
                found[name] = seen
        return found
