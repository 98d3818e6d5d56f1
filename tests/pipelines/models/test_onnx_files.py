from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")
pytest.importorskip("onnx", reason="onnx is an extra")

from fbench.pipelines.models import bev_network, network  # noqa: E402
from fbench.pipelines.models.bev_network import BevNetwork  # noqa: E402
from fbench.pipelines.models.network import CityDetector  # noqa: E402
from fbench.pipelines.models.onnx_files import take_weights  # noqa: E402
from fbench.pipelines.models.samples import CLASSES, RgbdSettings, Sample, TrainingSettings  # noqa: E402
from fbench.pipelines.models.train import Training  # noqa: E402
from fbench.pipelines.sensors.bev.detector import BUILTIN  # noqa: E402
from fbench.replay.contracts.errors import ConfigError, ModelError  # noqa: E402
from fbench.replay.data.images import encode_jpeg  # noqa: E402
from fbench.replay.data.messages import Image  # noqa: E402

pytestmark = pytest.mark.torch

MAKERS: dict[str, Callable[[], "torch.nn.Module"]] = {
    "camera": lambda: CityDetector(len(CLASSES)), "rgbd": lambda: CityDetector(len(CLASSES), 5),
    "learned3d": BevNetwork,
}  # fmt: skip


def make(model: str, seed: int) -> "torch.nn.Module":
    """A network whose normalization has seen something."""
    torch.manual_seed(seed)
    made = MAKERS[model]()
    for part in made.modules():
        if isinstance(part, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(part.running_mean, -0.5, 0.5)
            torch.nn.init.uniform_(part.running_var, 0.5, 2)
            torch.nn.init.uniform_(part.weight, 0.5, 1.5)
            torch.nn.init.uniform_(part.bias, -0.5, 0.5)
    return made.eval()


def outputs(made: "torch.nn.Module", model: str) -> list[np.ndarray]:
    width = {"camera": 3, "rgbd": 5, "learned3d": bev_network.NUM_CHANNELS}[model]
    blank = torch.from_numpy(np.random.default_rng(4).random((2, width, 64, 96), np.float32))
    with torch.no_grad():
        found = made.eval()(blank)
    return [part.numpy() for part in (found if isinstance(found, tuple) else (found,))]


def write(made: "torch.nn.Module", model: str, path: Path) -> Path:
    (bev_network if model == "learned3d" else network).export(made, path, {})
    return path


@pytest.mark.parametrize("model", list(MAKERS))
def test_a_network_with_the_weights_of_a_file_gives_what_the_files_gave(tmp_path, model):
    made, other = make(model, 1), make(model, 2)
    wanted = outputs(made, model)
    assert np.abs(outputs(other, model)[0] - wanted[0]).max() > 0.1
    take_weights(other, write(made, model, tmp_path / "a.onnx"))
    for found, value in zip(outputs(other, model), wanted, strict=True):
        np.testing.assert_allclose(found, value, rtol=1e-3, atol=1e-3)


def test_what_is_no_file_of_such_a_network_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    (tmp_path / "empty.onnx").write_bytes(b"")
    (tmp_path / "cut.onnx").write_bytes(BUILTIN.read_bytes()[:100_000])
    write(make("rgbd", 1), "rgbd", tmp_path / "rgbd.onnx")
    said = {
        "none": "can't be read", "text": "no ONNX file, or a damaged one", "cut": "no ONNX file, or a damaged one",
        "empty": "made of another network", "rgbd": "made of another network",
    }  # fmt: skip
    for name, what in said.items():
        with pytest.raises(ModelError, match=rf"{name}\.onnx: {what}"):
            take_weights(make("camera", 1), tmp_path / f"{name}.onnx")
    with pytest.raises(ModelError, match="made of another network"):
        take_weights(make("rgbd", 1), BUILTIN)


@pytest.mark.slow
def test_a_training_starts_from_the_file_and_keeps_what_normalization_did(tmp_path):
    draw = np.random.default_rng(0)
    image = Image("front", 1, 1, encode_jpeg(draw.integers(0, 255, (96, 128, 3)).astype(np.uint8)), "jpeg", (128, 96))
    made = [Sample("made", image, np.array([[20, 20, 90.0, 80.0]]), np.array([0]))]
    first = write(make("camera", 1), "camera", tmp_path / "a.onnx")
    settings = TrainingSettings(steps=1, crops=2, wholes=1, learning_rate=1e-3, warm_up=1)
    training = Training(made, settings, weights=first)
    np.testing.assert_allclose(
        outputs(training.network, "camera")[0], outputs(make("camera", 1), "camera")[0], atol=1e-3
    )
    before = {name: value.clone() for name, value in training.network.state_dict().items()}
    training.run(tmp_path / "a.checkpoint", lambda step, loss: None)
    after = training.network.state_dict()
    changed = {name.rpartition(".")[2] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"weight", "bias"}, "neither means nor variances of outputs"
    with pytest.raises(ConfigError, match="a checkpoint of a training with other first weights; delete it"):
        Training(made, settings).run(tmp_path / "a.checkpoint", lambda step, loss: None)
    with pytest.raises(ModelError, match="made of another network"):
        Training(made, replace(RgbdSettings(), steps=1), weights=first)
