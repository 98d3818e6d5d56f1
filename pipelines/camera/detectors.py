"""The detectors of all cameras of a rig."""

from collections.abc import Mapping
from pathlib import Path

from fbench.pipelines.camera.builtin import builtin_identity, with_builtin
from fbench.pipelines.camera.detector import CameraDetector, CameraParams
from fbench.replay.data import LogInfo


class CameraDetectors:
    """One detector for each distinct set of parameters; those of the kind are loaded at once.

    Raises:
        ConfigError: where the file with the weights is missing.
        ModelError: where the weights can't be used.
    """

    def __init__(self, params: CameraParams) -> None:
        self._params = params
        self._loaded: dict[CameraParams, CameraDetector] = {}
        self._detector(params)
        self._of: dict[str, CameraDetector] = {}
        self.identity: Mapping[str, object] = {}
        """What the manifest says of weights that no parameter names."""

    def assign(self, own: Mapping[str, CameraParams], log_info: LogInfo) -> None:
        """Give each camera of a log the detector of its own parameters; see the class for what is raised.

        On simulated logs `auto` is the built-in one.
        """
        own = with_builtin(own, log_info)
        found = {name: self._detector(params) for name, params in own.items()}
        self._of = {name: detector for name, detector in found.items() if detector is not None}
        self.identity = builtin_identity(own, self._params)

    def of(self, camera: str) -> CameraDetector | None:
        """Return the detector of a camera; `None` where no weights are named for it."""
        return self._of.get(camera)

    def _detector(self, params: CameraParams) -> CameraDetector | None:
        if not isinstance(params.weights, Path):
            return None
        if params not in self._loaded:
            self._loaded[params] = CameraDetector(params)
        return self._loaded[params]
