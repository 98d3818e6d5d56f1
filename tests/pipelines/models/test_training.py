from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")
pytest.importorskip("onnx", reason="onnx is an extra")

from fbench.pipelines.models.network import CityDetector, export  # noqa: E402
from fbench.pipelines.models.samples import CLASSES, Sample, TrainingSettings  # noqa: E402
from fbench.pipelines.models.train import Training  # noqa: E402
from fbench.pipelines.sensors.camera.detector import CameraDetector, CameraParams  # noqa: E402
from fbench.replay.contracts.errors import ConfigError  # noqa: E402
from fbench.replay.data.images import encode_jpeg  # noqa: E402
from fbench.replay.data.messages import Image  # noqa: E402

pytestmark = pytest.mark.torch

pytestmark = pytest.mark.slow
SHORT = TrainingSettings(steps=12, crops=4, wholes=1, warm_up=4, checkpoint_every=5)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    num = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(num)


def quiet(step: int, loss: float) -> None:
    pass


@pytest.fixture(scope="module")
def made() -> list[Sample]:
    """Red boxes on noise."""
    draw = np.random.default_rng(0)
    found = []
    for i in range(6):
        pixels = draw.integers(60, 120, (240, 320, 3)).astype(np.uint8)
        left, top = int(draw.integers(0, 220)), int(draw.integers(0, 160))
        pixels[top : top + 60, left : left + 90] = (0, 0, 255)
        image = Image("front", i, i, encode_jpeg(pixels), "jpeg", (320, 240))
        found.append(Sample(f"made {i}", image, np.array([[left, top, left + 90.0, top + 60.0]]), np.array([0])))
    return found


def test_it_goes_on_from_a_checkpoint_as_if_nothing_had_been(made, tmp_path):
    once, first, second = (Training(made, SHORT) for _ in range(3))
    whole = once.run(tmp_path / "whole.pt", quiet)

    def stop(step: int, loss: float) -> None:
        if step == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.run(tmp_path / "cut.pt", stop)
    steps = []
    again = second.run(tmp_path / "cut.pt", lambda step, loss: steps.append(step))
    assert steps == list(range(6, 13)), "the last checkpoint was after five"
    for (name, a), b in zip(whole.state_dict().items(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    assert second.losses == once.losses, "the curve is whole"
    assert len(second.losses) == 12


@pytest.mark.parametrize(
    "damage", ["cut", "not a checkpoint", "hello\n", "PK\3\4", "cos\nsystem\n", "G", "J1\n", "X12", "other", "origin"]
)
def test_a_damaged_checkpoint_is_refused(made, tmp_path, damage):
    path = tmp_path / "some.pt"
    Training(made, replace(SHORT, steps=1)).run(path, quiet)
    if damage == "other":
        torch.save({"step": 1}, path)
    elif damage == "origin":
        torch.save({**torch.load(path, weights_only=True), "made_from": ["logs"]}, path)
    else:
        path.write_bytes(path.read_bytes()[:1000] if damage == "cut" else damage.encode())
    with pytest.raises(ConfigError, match=r"some\.pt: .*delete it, or name another"):
        Training(made, SHORT).run(path, quiet)


def test_whatever_bytes_a_checkpoint_has_are_one_line(made, tmp_path):
    path, draw = tmp_path / "some.pt", np.random.default_rng(0)
    training = Training(made, replace(SHORT, steps=1))
    training.run(path, quiet)
    whole, said = path.read_bytes(), []
    for _ in range(60):
        data = bytearray(whole)
        for place in draw.integers(0, 3000, 3):
            data[place] = int(draw.integers(0, 256))
        path.write_bytes(data)
        try:
            training.resume(path)
        except ConfigError as error:
            said.append(str(error))
    assert len(said) > 10
    assert not [text for text in said if "\n" in text or not text.startswith(str(path))]


def test_a_checkpoint_of_something_else_is_refused(made, tmp_path):
    Training(made, SHORT).run(tmp_path / "a.pt", quiet)
    others = {
        "settings": Training(made, replace(SHORT, seed=2)), "samples": Training(made[:-1], SHORT),
        "threads": Training(made, SHORT, threads=3),
        "settings and samples": Training(made[:-1], replace(SHORT, steps=13)),
    }  # fmt: skip
    for what, other in others.items():
        with pytest.raises(ConfigError, match=rf"a\.pt: a checkpoint of a training with other {what}; delete it"):
            other.run(tmp_path / "a.pt", quiet)


def test_it_learns(made, tmp_path):
    losses: list[float] = []
    settings = replace(SHORT, steps=120, crops=6, learning_rate=4e-3)
    Training(made, settings).run(tmp_path / "a.pt", lambda step, loss: losses.append(loss))
    assert np.mean(losses[-10:]) < 0.8 * np.mean(losses[:10])


def test_the_file_gives_what_the_network_gives(tmp_path):
    torch.manual_seed(3)
    network = CityDetector(len(CLASSES)).eval()
    torch.nn.init.constant_(network.heads[0].what[1].bias, 0.0)
    export(network, tmp_path / "made.onnx", {})
    detector = CameraDetector(CameraParams(tmp_path / "made.onnx", 0.0, nms_iou=1.0))
    pixels = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    found = detector.infer(detector.prepare(pixels))
    rgb = torch.from_numpy(pixels[None, :, :, ::-1].copy()).permute(0, 3, 1, 2).float() / 255
    with torch.no_grad():
        logits, boxes = network(rgb)
    score, class_id = logits[0].sigmoid().max(0)
    best = int(score.argmax())
    assert found.score[0] == pytest.approx(float(score[best]), abs=1e-4)
    assert found.label[0] == CLASSES[int(class_id[best])]
    inside = boxes[0, :, best].numpy().clip(0, [640, 480, 640, 480])
    np.testing.assert_allclose(found.xyxy_px[0] + 0.5, inside, atol=0.05)
    assert (tmp_path / "made.onnx").stat().st_size < 4_000_000
