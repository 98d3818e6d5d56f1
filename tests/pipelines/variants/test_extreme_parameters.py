"""Every number that a parameter takes is either refused, or gives finite boxes."""

import re
import typing
import warnings
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache

import numpy as np
import pytest
from tests.pipelines.frames import cloud, frame, rig, scan
from tests.pipelines.sensors.stereo import pairs

from fbench.pipelines.variants.early import Early3D, Early3DParams
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.pipelines.variants.lidar import Lidar3D, Lidar3DParams
from fbench.pipelines.variants.radar import Radar3D, Radar3DParams
from fbench.pipelines.variants.stereo3d import Stereo3D, Stereo3DParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.settings import apply_settings, parameter_paths
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo

PIPELINES = {
    "lidar3d": (Lidar3D, Lidar3DParams),
    "radar3d": (Radar3D, Radar3DParams),
    "stereo3d": (Stereo3D, Stereo3DParams),
    "early3d": (Early3D, Early3DParams),
    "late3d": (Late3D, Late3DParams),
}
PAIR = pairs.rig()
VALUES = ("-1", "0", "1", "1000000", "1" + "0" * 21, "1" + "0" * 400, "1e-300", "1e30", "inf", "-inf")


def _numeric(params: object) -> Iterator[tuple[str, str]]:
    """Dotted names of the numeric parameters, and what to join copies of a value with."""
    for path in parameter_paths(params):
        *parents, name = path.split(".")
        owner = params
        for parent in parents:
            owner = getattr(owner, parent)
        assert is_dataclass(owner)
        hint = typing.get_type_hints(type(owner))[name]
        kinds = typing.get_args(hint) or (hint,)
        if {int, float} & set(kinds):
            yield path, "pair" if typing.get_origin(hint) is tuple else "single"


CASES = [
    (name, path, f"{value},{value}" if kind == "pair" else value)
    for name, (_, params) in PIPELINES.items()
    for path, kind in _numeric(params())
    for value in VALUES
]


@pytest.mark.parametrize("every", [13, pytest.param(3, marks=pytest.mark.slow)])  # of 10 values, 3 meets all in turn
@pytest.mark.parametrize("name", PIPELINES)
def test_every_number_is_refused_or_gives_finite_boxes(name: str, every: int) -> None:
    make, params = PIPELINES[name]
    refused = 0
    cases = [(path, value) for pipeline, path, value in CASES if pipeline == name]
    assert len(cases) > 100
    for path, value in cases[::every]:
        try:
            changed = apply_settings(params(), [f"{path}={value}"])
        except ConfigError:
            refused += 1
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            _check(make(changed), f"{path}={value}")
    assert refused > len(cases[::every]) / 2


@cache
def _of_cameras(index: int) -> Frame:
    return pairs.frame(PAIR, [pairs.road(), pairs.wall(15.0), *pairs.car(9.0, 0.0)], index=index)


def _check(pipeline: Lidar3D | Radar3D | Stereo3D | Early3D | Late3D, setting: str) -> None:
    is_stereo = isinstance(pipeline, Stereo3D)
    pipeline.start(PAIR if is_stereo else rig("cam", "lidar", "radar"), LogInfo("drive", "id"))
    for index in range(2):
        output = pipeline.step(_of_cameras(index) if is_stereo else frame(index, cloud(), scan()))
        for boxes in (output.detections, output.tracks):
            assert isinstance(boxes, Boxes3D), setting
            for values in (boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, boxes.score):
                assert np.isfinite(values).all(), setting


@pytest.mark.parametrize(
    ("setting", "match"),
    [
        ("lidar.cluster.eps_m=0", r"lidar\.cluster\.eps_m: expected between 0\.01 and 100, got 0"),
        (
            "lidar.cluster.min_points=" + "1" + "0" * 21,
            r"lidar\.cluster\.min_points: expected at most 1e\+06, got 10+$",
        ),
        ("lidar.ground.cell_m=-2", r"lidar\.ground\.cell_m: expected between 0\.5 and 100, got -2"),
        ("lidar.size.length_m=0", r"lidar\.size\.length_m: expected"),
        ("radar.size.length_m=0", r"radar\.size\.length_m: expected"),
        ("lidar.ego_side_m=-1", r"lidar\.ego_side_m: expected between 0 and 1000, got -1"),
        ("radar.doppler.max_forward_mps=-9", r"radar\.doppler\.max_forward_mps: expected between 0\.4 and 200, got -9"),
        ("radar.doppler.period_mps=1e-9", r"radar\.doppler\.period_mps: expected between 0\.1 and 1000, got 1e-09"),
        ("radar.min_magnitude_db=inf", r"radar\.min_magnitude_db: expected at most 1e\+06, got inf"),
        ("fusion.min_score=7", r"fusion\.min_score: expected between 0 and 1, got 7"),
        ("tracking.measured_std_m=1e200", r"tracking\.measured_std_m: expected at most 1e\+06, got 1e\+200"),
    ],
)
def test_messages_name_the_dotted_parameter(setting: str, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        apply_settings(Late3DParams(), [setting])


@pytest.mark.parametrize("setting", ["objects.ground.cell_m=-2", "objects.shape.top_m=2,2", "objects.size.width_m=0"])
def test_messages_of_stereo_name_the_dotted_parameter(setting: str) -> None:
    name = setting.partition("=")[0]
    with pytest.raises(ConfigError, match=rf"^{re.escape(name)}: expected"):
        apply_settings(Stereo3DParams(), [setting])
