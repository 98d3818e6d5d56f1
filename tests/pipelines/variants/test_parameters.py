from collections.abc import Callable

import pytest

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.plugins import default_params
from fbench.replay.contracts.settings import apply_settings, describe

UNLIMITED = ("radar.min_magnitude_db",)
"""Minus infinity lets everything through."""


def _numbers(name: str) -> list[str]:
    described = describe(default_params(load("pipelines", name)))
    return [path for path, value in described.items() if isinstance(value, int | float) and not isinstance(value, bool)]


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: CameraParams(min_score=1.5), r"camera\.min_score: expected between 0 and 1, got 1\.5"),
        (lambda: CameraParams(tile_overlap=1.0), r"camera\.tile_overlap: expected between 0 and 0\.9, got 1"),
        (lambda: CameraParams(tile_aspect=0.5), r"camera\.tile_aspect: expected at least 1, got 0\.5"),
        (lambda: CameraParams(tile_aspect=float("nan")), r"camera\.tile_aspect: expected at least 1, got nan"),
        (lambda: CameraParams(threads=0), r"camera\.threads: expected at least 1, got 0"),
        (lambda: CameraParams(input_wh=(0, 640)), r"camera\.input_wh: expected between 32 and 8192, got 0"),
        (lambda: Tracker2DParams(min_iou=-0.1), r"tracking\.min_iou: expected between 0 and 1, got -0\.1"),
        (lambda: Tracker2DParams(measured_std=0.0), r"tracking\.measured_std: expected at least 1e-06, got 0"),
        (lambda: Tracker3DParams(gate_m=0.0), r"tracking\.gate_m: expected at least 1e-06, got 0"),
        (lambda: Tracker3DParams(max_missed=-1), r"tracking\.max_missed: expected at least 0, got -1"),
    ],
)
def test_values_that_make_no_sense(make: Callable[[], object], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        make()


NAMES = (
    "camera2d", "lidar2d", "radar2d", "early2d", "late2d", "lidar3d", "radar3d", "stereo3d", "early3d", "late3d",
    "track", "plain2d", "plain3d",
)  # fmt: skip
NUMBERS = [(name, path) for name in NAMES for path in _numbers(name)]


@pytest.mark.parametrize(("name", "path"), NUMBERS)
def test_every_number_has_limits(name: str, path: str) -> None:
    """Infinity is refused everywhere but where it means no limit."""
    params = default_params(load("pipelines", name))
    for text in ("inf", "-inf", "1e30"):
        if path in UNLIMITED:
            continue
        with pytest.raises(ConfigError):
            apply_settings(params, [f"{path}={text}"])


@pytest.mark.parametrize(
    "setting",
    ["lidar.cluster.eps_m=0", "lidar.ground.cell_m=0.005", "lidar.ground.outliers=1.0", "lidar.cluster.min_points=0",
     "radar.doppler.band_mps=0", "radar.doppler.max_forward_mps=-9", "radar.doppler.period_mps=-3",
     "fusion.lidar_weight=9",
     "radar.full_score_echoes=-1", "lidar.size.width_m=-4", "lidar.shape.top_m=2,2", "tracking.rate_std_mps=inf"],
)  # fmt: skip
def test_settings_that_make_no_sense(setting: str) -> None:
    with pytest.raises(ConfigError):
        apply_settings(default_params(load("pipelines", "late3d")), [setting])
