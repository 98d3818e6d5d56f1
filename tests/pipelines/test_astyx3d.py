"""Detection on real recordings; the floors lie a good way below what was measured, so that only a loss trips them."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fbench.replay.cli import app


def run(*arguments: object) -> None:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="module")
def log(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("astyx") / "astyx.mcap"
    run("log", "import", "astyx", shared / "data" / "astyx", "-o", out)
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pipeline", "floor"), [("lidar3d", 0.52), ("radar3d", 0.74), ("early3d", 0.80), ("late3d", 0.82)]
)
def test_f1_of_vehicles(log: Path, shared: Path, tmp_path: Path, pipeline: str, floor: float):
    weights = shared / "weights" / "deimv2_femto" / "deimv2_hgnetv2_femto_coco.onnx"
    options = ("--set", f"camera.weights={weights}") if pipeline in ("early3d", "late3d") else ()
    run("replay", log, "-p", pipeline, "-o", tmp_path / "run", *options)
    scores = json.loads((tmp_path / "run" / "scores.json").read_text())
    bev = [row for row in scores if row["metric"] == "f1" and row["matching"].startswith("bev 2 m")]
    assert bev[0]["class"] == "vehicle"
    assert bev[0]["value"] > floor
