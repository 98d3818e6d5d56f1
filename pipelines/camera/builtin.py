"""The detector that fbench ships: trained on the simulated city, and used for nothing else unless asked for."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.weights.named import AUTO
from fbench.replay.data import LogInfo
from fbench.replay.log_keys import SIMULATED
from fbench.replay.settings import described_file

CITY_WEIGHTS = Path(__file__).with_name("city.onnx")
"""See `docs/detector.md`."""


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
    return {f"{name}.weights": described_file(CITY_WEIGHTS) for name in used if asked.weights != CITY_WEIGHTS}
