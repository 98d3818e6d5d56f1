import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")
pytest.importorskip("onnx", reason="onnx is an extra")

from fbench.pipelines.models.bev_train import assign, loss  # noqa: E402
from fbench.pipelines.sensors.bev import decoding  # noqa: E402
from fbench.pipelines.sensors.bev.decoding import CLASSES, NUM_OUTPUTS, OUT_CELL_M, DecodingParams, decode  # noqa: E402
from fbench.pipelines.sensors.bev.grid import REACH_M, SIDE  # noqa: E402

pytestmark = pytest.mark.torch

# x, y, z, length, width, height, yaw, velocity: one heads forward, one back, one to the left, one is ignored.
BOXES = [
    [10.3, -4.7, 0.8, 4.4, 1.8, 1.5, 0.3, 12.0, 1.0],
    [-20.9, 7.2, 1.7, 12.0, 2.5, 3.4, -2.8, -8.0, 0.0],
    [0.5, 30.5, 0.9, 0.5, 0.6, 1.8, 1.2, 0.0, 1.5],
    [33.0, 12.0, 0.8, 4.4, 1.8, 1.5, 0.0, 0.0, 0.0],
]
CLASS = [0, 2, 6, -1]


def tensors():
    return torch.tensor([BOXES]), torch.tensor([CLASS]), torch.tensor([[1, 0, 1, 0]])


def perfect_output():
    """What says of each cell exactly what it should."""
    boxes, class_id, known = tensors()
    targets = assign(boxes, class_id, known)
    output = torch.zeros(1, NUM_OUTPUTS, *targets.score.shape[1:])
    output[:, decoding.SCORE] = torch.logit(targets.score.clamp(1e-4, 1 - 1e-4))
    box = targets.box.permute(0, 3, 1, 2)
    rows = torch.arange(SIDE // decoding.STRIDE)
    cell = torch.stack(torch.meshgrid(rows, rows, indexing="ij"))
    output[:, decoding.OFFSET] = (box[:, :2] + REACH_M) / OUT_CELL_M - cell - 0.5
    output[:, decoding.HEIGHT] = box[:, 2]
    output[:, decoding.SIZE] = box[:, 3:6].clamp(min=0.1).log()
    output[:, decoding.AXIS] = torch.stack([torch.sin(2 * box[:, 6]), torch.cos(2 * box[:, 6])], 1)
    output[:, decoding.FORWARD] = torch.where(torch.cos(box[:, 6]) >= 0, 20.0, -20.0)
    output[:, decoding.KINDS] = 20.0 * torch.nn.functional.one_hot(targets.class_id.clamp(min=0), 7).permute(0, 3, 1, 2)
    output[:, decoding.SPEED] = box[:, 7:] / 10
    output[:, decoding.KNOWN] = torch.where(targets.is_speed_known > 0, 20.0, -20.0)
    return output, targets


def test_what_is_perfect_decodes_to_the_objects():
    output, _ = perfect_output()
    output[:, decoding.SCORE] = output[:, decoding.SCORE].sigmoid()
    found = decode(output[0].numpy(), DecodingParams(0.5, 0.15))
    assert len(found) == 3, "one for each object that isn't ignored"
    order = np.argsort(found.center_m[:, 0])[::-1]
    wanted = np.array(BOXES)[[0, 2, 1]]
    assert np.abs(found.center_m[order] - wanted[:, :3]).max() < 1e-4
    assert np.abs(found.size_lwh_m[order] - wanted[:, 3:6]).max() < 1e-4
    assert np.abs(np.exp(1j * found.yaw_rad[order]) - np.exp(1j * wanted[:, 6])).max() < 1e-4
    assert found.label[order].tolist() == ["car", "pedestrian", "truck"]
    velocity = found.velocity_mps[order]
    assert np.abs(velocity[:2, :2] - wanted[:2, 7:]).max() < 1e-4
    assert np.isnan(velocity[2, :2]).all(), "no echo told"


def test_what_is_perfect_costs_next_to_nothing_and_what_misses_an_object_costs_more():
    output, targets = perfect_output()
    least = float(loss(output, targets))
    assert least < 0.35, "only the flanks of the centers cost"
    worse = output.clone()
    worse[0, decoding.SCORE] = -9.0
    assert float(loss(worse, targets)) > least + 5


def test_nothing_is_a_mistake_in_an_ignored_object():
    _, targets = perfect_output()
    row, column = int((33.0 + REACH_M) // OUT_CELL_M), int((12.0 + REACH_M) // OUT_CELL_M)
    assert not targets.counts[0, row, column]
    assert targets.counts.sum() > 0.99 * targets.counts.numel()
    assert CLASSES[0] == "car"


def test_padding_is_no_object():
    boxes, class_id, known = tensors()
    padded = [torch.cat([part, torch.zeros_like(part)], 1) for part in (boxes, class_id, known)]
    found, wanted = assign(*padded), assign(boxes, class_id, known)
    assert torch.equal(found.score, wanted.score)
    assert torch.equal(found.weight, wanted.weight)
    assert torch.equal(found.counts, wanted.counts)
