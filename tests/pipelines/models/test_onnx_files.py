import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")
onnx = pytest.importorskip("onnx", reason="onnx is an extra")

from fbench.pipelines.models import bev_network, network  # noqa: E402
from fbench.pipelines.models.bev_network import BevNetwork  # noqa: E402
from fbench.pipelines.models.network import CityDetector  # noqa: E402
from fbench.pipelines.models.onnx_files import load_weights, read_weights  # noqa: E402
from fbench.pipelines.models.samples import CLASSES, RgbdSettings, Sample, TrainingSettings  # noqa: E402
from fbench.pipelines.models.train import Training  # noqa: E402
from fbench.pipelines.sensors.bev.detector import BUILTIN  # noqa: E402
from fbench.pipelines.sensors.bev.grid import NUM_CHANNELS, SIDE  # noqa: E402
from fbench.pipelines.sensors.camera.model import load  # noqa: E402
from fbench.replay.contracts.errors import ConfigError, ModelError  # noqa: E402
from fbench.replay.data.images import encode_jpeg  # noqa: E402
from fbench.replay.data.messages import Image  # noqa: E402

pytestmark = pytest.mark.torch

MAKERS: dict[str, Callable[[], Any]] = {
    "camera": lambda: CityDetector(len(CLASSES)), "rgbd": lambda: CityDetector(len(CLASSES), 5),
    "learned3d": BevNetwork,
}  # fmt: skip


def make(model: str, seed: int) -> Any:
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


def outputs(made: Any, model: str) -> list[np.ndarray]:
    width = {"camera": 3, "rgbd": 5, "learned3d": NUM_CHANNELS}[model]
    blank = torch.from_numpy(np.random.default_rng(4).random((2, width, 64, 96), np.float32))
    with torch.no_grad():
        found = made.eval()(blank)
    return [part.numpy() for part in (found if isinstance(found, tuple) else (found,))]


def write(made: Any, model: str, path: Path) -> Path:
    (bev_network if model == "learned3d" else network).export(made, path, {})
    return path


@pytest.mark.parametrize("model", list(MAKERS))
def test_a_network_with_the_weights_of_a_file_gives_what_the_files_gave(tmp_path, model):
    made, other = make(model, 1), make(model, 2)
    wanted = outputs(made, model)
    assert np.abs(outputs(other, model)[0] - wanted[0]).max() > 0.1
    load_weights(other, read_weights(write(made, model, tmp_path / "a.onnx")))
    for found, value in zip(outputs(other, model), wanted, strict=True):
        np.testing.assert_allclose(found, value, rtol=1e-3, atol=1e-3)


def test_the_builtin_network_gives_what_its_file_gives():
    network = make("learned3d", 1)
    load_weights(network, read_weights(BUILTIN))
    points = np.random.default_rng(2).random((1, NUM_CHANNELS, SIDE, SIDE), np.float32)
    with torch.no_grad():
        found = network(torch.from_numpy(points)).numpy()
    (wanted,) = load(BUILTIN, 1).run(None, {"points": points})
    np.testing.assert_allclose(found[:, 1:], wanted[:, 1:], rtol=1e-4, atol=1e-4)


def change_first(path: Path, change: Callable[[Any], None]) -> None:
    """Change the weights of the first convolution of a file."""
    model = onnx.load(str(path))
    name = next(node.input[1] for node in model.graph.node if node.op_type == "Conv")
    change(next(one for one in model.graph.initializer if one.name == name))
    path.write_bytes(model.SerializeToString())


def nan(tensor: Any) -> None:
    values = np.full(tuple(tensor.dims), np.nan, np.float32)
    tensor.raw_data = values.tobytes()


def short(tensor: Any) -> None:
    tensor.raw_data = tensor.raw_data[:40]


def half(tensor: Any) -> None:
    tensor.data_type = onnx.TensorProto.FLOAT16


def elsewhere(tensor: Any) -> None:
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/hostname")


DAMAGED = "damaged, or not an ONNX file"


@pytest.mark.parametrize(
    ("damage", "said"),
    [(nan, DAMAGED), (short, DAMAGED), (half, DAMAGED), (elsewhere, "keeps weights in other files")],
)
def test_damaged_weights_are_refused(tmp_path, damage, said):
    path = write(make("camera", 1), "camera", tmp_path / "a.onnx")
    change_first(path, damage)
    with pytest.raises(ModelError, match=rf"a\.onnx: .*{said}"):
        load_weights(make("camera", 1), read_weights(path))


def test_what_is_no_file_of_such_a_network_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    (tmp_path / "card.onnx").write_text('{"model": "camera"}')
    (tmp_path / "empty.onnx").write_bytes(b"")
    (tmp_path / "cut.onnx").write_bytes(BUILTIN.read_bytes()[:100_000])
    write(make("rgbd", 1), "rgbd", tmp_path / "rgbd.onnx")
    said = {
        "text": "not an ONNX file", "card": "not an ONNX file", "empty": DAMAGED, "cut": "not an ONNX file",
        "rgbd": "weights of another network",
    }  # fmt: skip
    for name, what in said.items():
        with pytest.raises(ModelError, match=rf"{name}\.onnx: .*{what}"):
            load_weights(make("camera", 1), read_weights(tmp_path / f"{name}.onnx"))
    with pytest.raises(ModelError, match="weights of another network"):
        load_weights(make("rgbd", 1), read_weights(BUILTIN))


def test_a_network_of_the_same_shapes_but_other_strides_is_refused(tmp_path):
    path = write(make("camera", 1), "camera", tmp_path / "fine.onnx")
    model = onnx.load(str(path))
    first = next(node for node in model.graph.node if node.op_type == "Conv")
    strides = next(one for one in first.attribute if one.name == "strides")
    assert list(strides.ints) == [2, 2]
    first.attribute.remove(strides)  # 1 each way
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match="weights of another network"):
        load_weights(make("camera", 1), read_weights(path))


def test_what_cant_be_read_is_refused(tmp_path):
    os.mkfifo(tmp_path / "fifo.onnx")
    (tmp_path / "folder.onnx").mkdir()
    for name, why in {"none": "No such file", "fifo": "not a regular file", "folder": "not a regular file"}.items():
        with pytest.raises(ConfigError, match=rf"{name}\.onnx: weights can't be read \({why}"):
            read_weights(tmp_path / f"{name}.onnx")


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    draw = np.random.default_rng(0)
    image = Image("front", 1, 1, encode_jpeg(draw.integers(0, 255, (96, 128, 3)).astype(np.uint8)), "jpeg", (128, 96))
    return [Sample("made", image, np.array([[20, 20, 90.0, 80.0]]), np.array([0]))]


SHORT = TrainingSettings(steps=2, crops=1, wholes=1, learning_rate=1e-3, warm_up=1, checkpoint_every=1)


@pytest.mark.slow
def test_a_training_starts_from_the_file_and_keeps_normalization(samples, tmp_path):
    first = read_weights(write(make("camera", 1), "camera", tmp_path / "a.onnx"))
    (tmp_path / "a.onnx").unlink()
    training = Training(samples, SHORT, weights=first)
    wanted = outputs(make("camera", 1), "camera")[0]
    np.testing.assert_allclose(outputs(training.network, "camera")[0], wanted, rtol=1e-3, atol=1e-3)
    before = {name: value.clone() for name, value in training.network.state_dict().items()}
    training.run(tmp_path / "a.checkpoint", lambda step, loss: None)
    after = training.network.state_dict()
    changed = {name.rpartition(".")[2] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"weight", "bias"}, "neither means nor variances of outputs"
    with pytest.raises(ConfigError, match="a checkpoint of a training with other weights to start from; delete it"):
        Training(samples, SHORT).run(tmp_path / "a.checkpoint", lambda step, loss: None)
    with pytest.raises(ModelError, match="weights of another network"):
        Training(samples, replace(RgbdSettings(), steps=1), weights=first)


@pytest.mark.slow
def test_a_training_from_weights_goes_on_as_if_nothing_had_been(samples, tmp_path):
    first = read_weights(write(make("camera", 1), "camera", tmp_path / "a.onnx"))
    whole = Training(samples, SHORT, weights=first).run(tmp_path / "whole.pt", lambda step, loss: None)

    def stop(step: int, loss: float) -> None:
        if step == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Training(samples, SHORT, weights=first).run(tmp_path / "cut.pt", stop)
    again = Training(samples, SHORT, weights=first).run(tmp_path / "cut.pt", lambda step, loss: None)
    for (name, a), b in zip(whole.state_dict().items(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
