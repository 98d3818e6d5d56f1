"""The detectors of all cameras of a rig."""

from collections.abc import Mapping

from fbench.pipelines.camera.detector import CameraDetector, CameraParams


class CameraDetectors:
    """One detector for each distinct set of parameters; those of the kind are loaded at once.

    Raises:
        ConfigError: where the file with the weights is missing.
        ModelError: where the weights can't be used.
    """

    def __init__(self, params: CameraParams) -> None:
        self._loaded: dict[CameraParams, CameraDetector] = {}
        self._detector(params)
        self._of: dict[str, CameraDetector] = {}

    def assign(self, own: Mapping[str, CameraParams]) -> None:
        """Give each camera the detector of its own parameters; see the class for what is raised."""
        found = {name: self._detector(params) for name, params in own.items()}
        self._of = {name: detector for name, detector in found.items() if detector is not None}

    def of(self, camera: str) -> CameraDetector | None:
        """Return the detector of a camera; `None` where no weights are named for it."""
        return self._of.get(camera)

    def _detector(self, params: CameraParams) -> CameraDetector | None:
        if params.weights is None:
            return None
        if params not in self._loaded:
            self._loaded[params] = CameraDetector(params)
        return self._loaded[params]
