import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")

from fbench.pipelines.models.network import CityDetector, cell_strides, cells  # noqa: E402
from fbench.pipelines.models.train import Targets, Truths, assign, giou, loss  # noqa: E402

pytestmark = pytest.mark.torch

SIZE = (256, 128)
POINTS, STRIDES = cells(*SIZE), cell_strides(*SIZE)
"""32 x 16, 16 x 8 and 8 x 4 cells."""
NOTHING = [0.0, 0.0, 0.0, 0.0]


def assigned(xyxy, class_id, ignored=NOTHING) -> Targets:
    return assign(POINTS, STRIDES, Truths(torch.tensor([xyxy]), torch.tensor([class_id]), torch.tensor([[ignored]])))


def found(targets: Targets) -> list[tuple[float, float, float]]:
    """Stride and middle of the cells with an object."""
    rows = torch.stack([STRIDES, *POINTS])[:, targets.is_object[0]]
    return [tuple(row) for row in rows.T.tolist()]


def everywhere(xyxy):
    """Boxes (1, 4, N) that are the same in all cells."""
    return torch.tensor(xyxy)[None, :, None].expand(1, 4, POINTS.shape[1])


def test_cells_lie_in_the_middle_of_their_squares():
    assert POINTS.shape == (2, 512 + 128 + 32)
    assert STRIDES.tolist() == [8.0] * 512 + [16.0] * 128 + [32.0] * 32
    assert POINTS[:, 0].tolist() == [4, 4]
    assert POINTS[:, 1].tolist() == [12, 4]
    assert POINTS[:, -1].tolist() == [240, 112]


def test_small_objects_are_found_by_the_nine_fine_cells_around_their_middle():
    targets = assigned([[24.0, 24.0, 64.0, 64.0]], [2])
    assert found(targets) == [(8, x, y) for y in (36, 44, 52) for x in (36, 44, 52)]
    assert (targets.class_id[0][targets.is_object[0]] == 2).all()


def test_sizes_between_two_levels_are_found_by_both():
    assert {stride for stride, _, _ in found(assigned([[64.0, 32.0, 128.0, 96.0]], [0]))} == {8.0, 16.0}
    assert {stride for stride, _, _ in found(assigned([[10.0, 2.0, 250.0, 120.0]], [0]))} == {32.0}


def test_what_is_smaller_than_a_cell_is_found_by_the_one_that_holds_its_middle():
    assert found(assigned([[13.0, 13.0, 15.0, 15.0]], [0])) == [(8.0, 12.0, 12.0)]


def test_a_cell_of_two_objects_takes_the_smaller():
    both = [[0.0, 0.0, 76.0, 76.0], [30.0, 30.0, 46.0, 46.0]]
    targets = assigned(both, [0, 1])
    at = (POINTS[0] == 36) & (POINTS[1] == 36) & (STRIDES == 8)
    assert targets.class_id[0][at].tolist() == [1]
    assert targets.xyxy[0][at].tolist() == [both[1]]


def test_cells_in_ignored_boxes_arent_judged():
    targets = assigned([NOTHING], [-1], [0.0, 0.0, 256.0, 64.0])
    assert not targets.is_object.any()
    assert (targets.counts[0] == (POINTS[1] > 64)).all()


def test_objects_in_ignored_boxes_are():
    targets = assigned([[24.0, 24.0, 64.0, 64.0]], [0], [0.0, 0.0, 256.0, 128.0])
    assert (targets.counts == targets.is_object).all()


def test_overlaps_by_hand():
    box, half, apart = torch.tensor([[0.0, 0, 2, 2]]), torch.tensor([[1.0, 0, 3, 2]]), torch.tensor([[5.0, 5, 6, 6]])
    assert giou(box, box).tolist() == pytest.approx([1.0])
    assert giou(box, half).tolist() == pytest.approx([1 / 3])
    assert giou(box, apart).tolist() == pytest.approx([-(36 - 5) / 36])


def test_the_loss_of_the_right_answer_is_nothing_and_has_a_gradient_elsewhere():
    box = [24.0, 24.0, 64.0, 64.0]
    targets = assigned([box], [0])
    right = torch.where(targets.is_object, 20.0, -20.0)[:, None]
    assert loss(right, everywhere(box), targets) < 1e-5
    scores = torch.zeros(1, 1, POINTS.shape[1], requires_grad=True)
    loss(scores, everywhere([24.0, 24.0, 60.0, 64.0]), targets).backward()
    is_object = targets.is_object[0]
    assert (scores.grad[0, 0][is_object] < 0).all(), "these should rise"
    assert (scores.grad[0, 0][~is_object] > 0).all(), "and these fall"


def test_scores_should_say_how_well_boxes_fit():
    targets = assigned([[24.0, 24.0, 64.0, 64.0]], [0])
    boxes = everywhere([24.0, 24.0, 44.0, 64.0])  # half of it
    scores = torch.where(targets.is_object, 0.0, -20.0)[:, None].requires_grad_()
    loss(scores, boxes, targets).backward()
    assert scores.grad[0, 0][targets.is_object[0]].abs().max() < 1e-6, "0.5 is right"


def test_an_image_without_objects_teaches_only_that():
    scores = torch.zeros(1, 1, POINTS.shape[1], requires_grad=True)
    value = loss(scores, everywhere([0.0, 0.0, 1.0, 1.0]), assigned([NOTHING], [-1]))
    value.backward()
    assert value > 0
    assert (scores.grad > 0).all()


def test_the_network_is_small_and_begins_with_low_scores():
    network = CityDetector(7).eval()
    assert sum(p.numel() for p in network.parameters()) < 1_000_000, "4 MB as float32"
    with torch.no_grad():
        logits, boxes = network(torch.zeros(2, 3, 128, 256))
    assert logits.shape == (2, 7, 672)
    assert boxes.shape == (2, 4, 672)
    assert logits.sigmoid().max() < 0.1
    assert (boxes[:, 2:] > boxes[:, :2]).all()
