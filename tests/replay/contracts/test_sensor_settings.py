from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.contracts.settings import apply_settings, describe, parameter_paths
from fbench.replay.data.rig import Mount, Rig

UPRIGHT = np.array([0.0, 0, 0, 1])


@dataclass(frozen=True)
class Cluster:
    eps_m: float = 0.6


@dataclass(frozen=True)
class Lidar:
    min_range_m: float = 2.5
    cluster: Cluster = field(default_factory=Cluster)


@dataclass(frozen=True)
class Camera:
    min_score: float = 0.6
    weights: Path | None = None

    def __post_init__(self):
        if self.min_score > 1:
            raise ConfigError(f"camera.min_score: expected at most 1, got {self.min_score:g}")


@dataclass(frozen=True)
class Params:
    camera: Camera = field(default_factory=Camera)
    lidar: Lidar = field(default_factory=Lidar)
    by_sensor: tuple[str, ...] = ()
    """What it means."""


@dataclass(frozen=True)
class Plain:
    lidar: Lidar = field(default_factory=Lidar)


def rig(**kinds):
    return Rig({name: Mount(kind, np.zeros(3), UPRIGHT) for name, kind in kinds.items()}, {})


RIG = rig(
    **{"front": "camera", "front.left": "camera", "sensing/lidar/top": "lidar", "lidar.rear": "lidar", "r": "radar"}
)


def own(kind, *settings, differing=None):
    params = apply_settings(Params(), settings)
    return SensorSettings(params, RIG).own(kind, getattr(params, kind), differing)


def test_a_sensor_goes_before_its_kind_whatever_comes_first():
    scores = own("camera", "front.min_score=0.3", "camera.min_score=0.4", "front.left.min_score=0.2")
    assert {name: p.min_score for name, p in scores.items()} == {"front": 0.3, "front.left": 0.2}
    assert own("camera", "front.min_score=0.3", "front.min_score=0.1")["front"].min_score == 0.1
    assert own("camera") == {"front": Camera(), "front.left": Camera()}


def test_names_with_slashes_dots_and_the_name_of_a_kind():
    ranges = own("lidar", "sensing/lidar/top.min_range_m=1", "lidar.rear.min_range_m=4", "lidar.min_range_m=3")
    assert {name: p.min_range_m for name, p in ranges.items()} == {"sensing/lidar/top": 1, "lidar.rear": 4}
    assert own("lidar", "lidar.rear.cluster.eps_m=2")["lidar.rear"].cluster.eps_m == 2


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("frnt.min_score=1", "--set frnt.min_score=1: no such sensor or parameter; did you mean 'front.min_score'?"),
        ("lidr.min_range_m=1", "no such sensor or parameter; did you mean 'lidar.min_range_m'?"),
        ("zzz.qqq=1", "--set zzz.qqq=1: no such sensor or parameter; sensors are: front, front.left, lidar.rear, sens"),
        ("front.min_scor=1", "unknown parameter 'front.min_scor'; did you mean 'front.min_score'?"),
        ("front.left.cluster.eps_m=1", "unknown parameter 'front.left.cluster.eps_m'"),
        ("front.min_score=much", "--set front.min_score=much: expected float"),
        ("front.min_score=3", "--set front.min_score=3: camera.min_score: expected at most 1, got 3"),
        ("r.min_range_m=3", "--set r.min_range_m=3: 'r' is a radar, and the pipeline has no use for it"),
    ],
)
def test_settings_that_fit_nothing(setting, message):
    with pytest.raises(ConfigError) as error:
        own("camera", setting)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_what_acts_on_all_together_is_common():
    top = "sensing/lidar/top"
    assert own("lidar", f"{top}.min_range_m=1", differing=["min_range_m"])[top].min_range_m == 1
    with pytest.raises(
        ConfigError, match=r"top\.cluster\.eps_m=1: it is common to all LiDARs, set lidar\.cluster\.eps_m$"
    ):
        own("lidar", f"{top}.cluster.eps_m=1", differing=["min_range_m"])
    with pytest.raises(ConfigError, match="unknown parameter"):
        own("lidar", f"{top}.clutser.eps_m=1", differing=["min_range_m"])
    assert own("lidar", f"{top}.cluster.eps_m=1", differing=["cluster"])[top].cluster.eps_m == 1


@pytest.mark.parametrize(
    ("params", "setting", "message"),
    [
        (Plain(), "front.min_range_m=1", "unknown parameter 'front.min_range_m'; did you mean 'lidar.min_range_m'"),
        (Params(), "min_range_m=1", "unknown parameter 'min_range_m'; did you mean 'lidar.min_range_m'"),
        (Params(), "lidar.clutser.eps_m=1", "did you mean 'lidar.cluster.eps_m'"),
        (Params(), "by_sensor=a.b=1", "unknown parameter 'by_sensor'"),
        (Params(), "front.min_score", "expected NAME=VALUE"),
    ],
)
def test_settings_that_no_rig_can_make_right(params, setting, message):
    with pytest.raises(ConfigError) as error:
        apply_settings(params, [setting])
    assert message in str(error.value)


def test_the_manifest_shows_them_by_name(tmp_path):
    weights = tmp_path / "private" / "net.onnx"
    weights.parent.mkdir()
    weights.write_bytes(b"abc")
    params = apply_settings(Params(), ["front.min_score=0.3", f"front.weights={weights}", "front.min_score=0.2"])
    described = describe(params)
    assert described["front.min_score"] == "0.2"
    assert described["front.weights"] == {
        "file": "net.onnx", "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
    }  # fmt: skip
    assert "private" not in str(described)
    assert "by_sensor" not in described
    assert "by_sensor" not in parameter_paths(params)
    with pytest.raises(ConfigError, match="no such file"):
        describe(apply_settings(Params(), ["front.weights=absent.onnx"]))
