from collections.abc import Callable

import pytest

from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.tracking.tracker2d import Tracker2DParams
from fbench.pipelines.tracking.tracker3d import Tracker3DParams
from fbench.replay.errors import ConfigError


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: CameraParams(min_score=1.5), r"camera\.min_score: expected between 0 and 1, got 1\.5"),
        (lambda: CameraParams(tile_overlap=1.0), r"camera\.tile_overlap: expected between 0 and 0\.9, got 1"),
        (lambda: CameraParams(tile_aspect=0.5), r"camera\.tile_aspect: expected at least 1, got 0\.5"),
        (lambda: CameraParams(tile_aspect=float("nan")), r"camera\.tile_aspect: expected at least 1, got nan"),
        (lambda: CameraParams(threads=0), r"camera\.threads: expected at least 1, got 0"),
        (lambda: CameraParams(input_wh=(0, 640)), r"camera\.input_wh: expected at least 32, got 0"),
        (lambda: Tracker2DParams(min_iou=-0.1), r"tracking\.min_iou: expected between 0 and 1, got -0\.1"),
        (lambda: Tracker2DParams(measured_std=0.0), r"tracking\.measured_std: expected at least 1e-06, got 0"),
        (lambda: Tracker3DParams(gate_m=0.0), r"tracking\.gate_m: expected at least 1e-06, got 0"),
        (lambda: Tracker3DParams(max_missed=-1), r"tracking\.max_missed: expected at least 0, got -1"),
    ],
)
def test_values_that_make_no_sense(make: Callable[[], object], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        make()
