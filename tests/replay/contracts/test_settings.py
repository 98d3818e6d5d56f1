from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.settings import apply_settings, describe, parameter_paths


@dataclass(frozen=True)
class Cluster:
    eps_m: float = 0.6
    min_points: int = 5
    method: Literal["dbscan", "hdbscan"] = "dbscan"


@dataclass(frozen=True)
class Params:
    cluster: Cluster = field(default_factory=Cluster)
    weights: Path | None = None
    on: bool = True
    judge: Literal["model", "rules"] | None = None
    size_wh: tuple[int, int] = (416, 416)


def test_nested_values_are_set():
    settings = ["cluster.eps_m=1.5", "cluster.min_points=3", "on=false", "weights=a/b.onnx", "size_wh=832,256"]
    changed = apply_settings(Params(), settings)
    assert changed == Params(Cluster(1.5, 3), Path("a/b.onnx"), False, size_wh=(832, 256))
    assert apply_settings(changed, ["weights=none"]).weights is None


def test_later_settings_win():
    assert apply_settings(Params(), ["cluster.eps_m=1", "cluster.eps_m=2"]).cluster.eps_m == 2.0


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("cluster.eps=1", "unknown parameter 'cluster.eps'; did you mean 'cluster.eps_m'"),
        ("eps_m=1", "unknown parameter 'eps_m'; did you mean 'cluster.eps_m'"),
        ("clutser.eps_m=1", "did you mean 'cluster.eps_m'"),
        ("cluster=1", "'cluster' isn't a single parameter"),
        ("cluster.eps_m.x=1", "'cluster.eps_m.x' isn't a single parameter"),
        ("cluster.eps_m", "expected NAME=VALUE"),
        ("cluster.eps_m=wide", "expected float"),
        ("cluster.eps_m=nan", "expected float"),
        ("cluster.min_points=2.5", "expected int"),
        ("cluster.method=magic", "--set cluster.method=magic: expected dbscan or hdbscan"),
        ("judge=magic", "--set judge=magic: expected model, rules or none"),
        ("on=maybe", "expected bool"),
        ("size_wh=1", "--set size_wh=1"),
    ],
)
def test_bad_settings(setting, message):
    with pytest.raises(ConfigError) as error:
        apply_settings(Params(), [setting])
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_files_of_parameters_must_exist(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert apply_settings(Params(), ["weights=~/net.onnx"]).weights == tmp_path / "net.onnx"
    for path in (tmp_path / "absent.onnx", tmp_path):
        with pytest.raises(ConfigError, match="no such file"):
            describe(Params(weights=path))


def test_description_is_ready_for_json():
    described = describe(apply_settings(Params(), ["cluster.eps_m=-inf"]))
    assert described["cluster.eps_m"] == "-inf"


def test_description_names_files_by_content(tmp_path):
    weights = tmp_path / "secret" / "net.onnx"
    weights.parent.mkdir()
    weights.write_bytes(b"abc")
    described = describe(Params(weights=weights))
    sha = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert described["weights"] == {"file": "net.onnx", "sha256": sha}
    assert described["size_wh"] == [416, 416]
    assert list(described) == parameter_paths(Params())
