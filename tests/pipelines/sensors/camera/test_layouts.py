"""What each model family's outputs mean, on arrays made by hand."""

import numpy as np
import pytest

from fbench.pipelines.sensors.camera.families import Detr, Torchvision, Ultralytics, YoloX, grid
from fbench.pipelines.sensors.camera.layouts import COCO_80, COCO_91

PIXELS = np.full((50, 200, 3), (255, 0, 0), np.uint8)
SIZE = (200, 50)


def test_detr_reads_boxes_as_they_are() -> None:
    layout = Detr("images", (100, 100), COCO_80, None, "orig_target_sizes", (0, 1, 2))
    feeds = layout.feeds([PIXELS, PIXELS])
    assert feeds["images"].shape == (2, 3, 100, 100)
    assert feeds["orig_target_sizes"].tolist() == [[200, 50]] * 2
    np.testing.assert_allclose(feeds["images"][0, :, 0, 0], [0, 0, 1])
    outputs = [np.array([[2, 7]]), np.array([[[1, 2, 30, 40], [5, 6, 7, 8]]]), np.array([[0.9, 0.3]])]
    (found,) = layout.read(outputs, [SIZE], 0.5)
    assert (found.xyxy.tolist(), found.label.tolist(), found.score.tolist()) == ([[1, 2, 30, 40]], ["car"], [0.9])


def yolox_raw(cell: int, values: list[float]) -> np.ndarray:
    raw = np.zeros((1, 64 + 16 + 4, 85), np.float32)
    raw[0, cell, :5] = values
    raw[0, cell, 5 + 2] = 0.5
    return raw


def test_yolox_decodes_the_grid() -> None:
    layout = YoloX("images", (64, 64), COCO_80, 1, (8, 16, 32))
    fed = layout.feeds([PIXELS])["images"]
    assert fed[0, :, 0, 0].tolist() == [255, 0, 0]
    assert fed[0, :, 63, 63].tolist() == [114, 114, 114]
    # Cell 64 + 5 is column 1, row 1 of stride 16: center (1 + 0.5, 1 + 0.25) * 16, size e^0, e^ln2 times 16.
    raw = yolox_raw(64 + 5, [0.5, 0.25, 0.0, np.log(2.0), 0.9])
    (found,) = layout.read([raw], [(64, 64)], 0.3)
    np.testing.assert_allclose(found.xyxy, [[16, 4, 32, 36]], rtol=1e-6)
    np.testing.assert_allclose(found.score, [0.45], rtol=1e-6)
    assert found.label.tolist() == ["car"]
    (wide,) = layout.read([raw], [(128, 64)], 0.3)
    np.testing.assert_allclose(wide.xyxy, [[32, 8, 64, 72]], rtol=1e-6)


def test_yolox_that_was_decoded_by_the_export() -> None:
    layout = YoloX("images", (64, 64), COCO_80, 1, (8, 16, 32))
    raw = yolox_raw(69, [24, 20, 16, 32, 0.9])
    cells = grid((64, 64), (8, 16, 32))
    raw[0, :69, :2] = (cells[:69, :2] + 0.5) * cells[:69, 2:]
    (found,) = layout.read([raw], [(64, 64)], 0.3)
    np.testing.assert_allclose(found.xyxy, [[16, 4, 32, 36]], rtol=1e-6)


def test_yolox_survives_huge_exponents() -> None:
    layout = YoloX("images", (64, 64), COCO_80, 1, (8, 16, 32))
    (found,) = layout.read([yolox_raw(0, [0, 0, 1e9, 1, 0.9])], [(64, 64)], 0.3)
    assert np.isfinite(found.xyxy).all()


def test_grid_counts_cells_row_by_row() -> None:
    cells = grid((416, 416), (8, 16, 32))
    assert len(cells) == 3549
    assert cells[53].tolist() == [1, 1, 8]
    assert cells[52 * 52 + 27].tolist() == [1, 1, 16]


def test_yolov8_letterboxes_to_the_middle() -> None:
    layout = Ultralytics("images", (100, 100), COCO_80, 1, "classes")
    fed = layout.feeds([PIXELS])["images"]
    np.testing.assert_allclose(fed[0, :, 50, 50], [0, 0, 1])
    np.testing.assert_allclose(fed[0, :, 0, 0], 114 / 255, rtol=1e-6)
    raw = np.zeros((1, 84, 2))
    raw[0, :4, 0], raw[0, 4 + 5, 0] = [50, 50, 20, 10], 0.7
    (found,) = layout.read([raw], [SIZE], 0.5)
    # Scale 1/2, 25 rows of image, so 75 // 2 = 37 rows of grey above.
    assert found.xyxy.tolist() == [[80, 16, 120, 36]]
    assert (found.label.tolist(), found.score.tolist()) == (["bus"], [0.7])


def test_yolov5_multiplies_objectness_and_class() -> None:
    layout = Ultralytics("images", (200, 50), COCO_80, 1, "objectness")
    raw = np.zeros((1, 2, 85))
    raw[0, 0, :5], raw[0, 0, 5 + 3] = [50, 25, 20, 10, 0.5], 0.8
    (found,) = layout.read([raw], [SIZE], 0.3)
    assert found.xyxy.tolist() == [[40, 20, 60, 30]]
    assert (found.label.tolist(), found.score.tolist()) == (["motorcycle"], [0.4])


def test_yolo_with_nms_inside() -> None:
    layout = Ultralytics("images", (200, 50), COCO_80, 1, "final")
    raw = np.array([[[40, 20, 60, 30, 0.9, 1.0], [0, 0, 0, 0, 0, 0]]])
    (found,) = layout.read([raw], [SIZE], 0.3)
    assert (found.xyxy.tolist(), found.label.tolist()) == ([[40, 20, 60, 30]], ["bicycle"])


@pytest.mark.parametrize(("input_wh", "expected"), [(None, [1, 2, 30, 40]), ((100, 100), [2, 1, 60, 20])])
def test_torchvision_feeds_one_image(input_wh: tuple[int, int] | None, expected: list[float]) -> None:
    layout = Torchvision("image", input_wh, COCO_91, 1, False, (1, 0, 2))
    assert layout.feeds([PIXELS])["image"].shape == ((3, 100, 100) if input_wh else (3, 50, 200))
    outputs = [np.array([[1.0, 2, 30, 40], [0, 0, 9, 9]]), np.array([3, 5]), np.array([0.9, 0.9])]
    (found,) = layout.read(outputs, [SIZE], 0.5)
    assert (found.xyxy.tolist(), found.label.tolist()) == ([expected], ["car"])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, 3e38])
@pytest.mark.parametrize("column", range(6))
def test_damaged_rows_are_dropped_without_warnings(bad: float, column: int) -> None:
    """Warnings are errors here."""
    final = np.array([[[40, 20, 60, 30, 0.9, 1.0]] * 2], np.float32)
    final[0, 0, column] = bad
    (found,) = Ultralytics("images", (200, 50), COCO_80, 1, "final").read([final], [SIZE], 0.3)
    assert found.xyxy.tolist() == [[40, 20, 60, 30]]
    objectness = np.zeros((1, 2, 85), np.float32)
    objectness[0, :, :8] = [50, 25, 20, 10, 0.5, 0, 0, 0.8]
    objectness[0, 0, column] = bad
    (found,) = Ultralytics("images", (200, 50), COCO_80, 1, "objectness").read([objectness], [SIZE], 0.3)
    assert found.xyxy.tolist() == [[40, 20, 60, 30]]
    raw = yolox_raw(69, [0.5, 0.25, 0.0, np.log(2.0), 0.9])
    raw[0, 0, 4], raw[0, 0, 7], raw[0, 0, column] = 0.9, 0.5, bad
    (found,) = YoloX("images", (64, 64), COCO_80, 1, (8, 16, 32)).read([raw], [(64, 64)], 0.3)
    assert len(found) == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_class_ids_that_are_no_numbers_are_unknown(bad: float) -> None:
    layout = Detr("images", (100, 100), COCO_80, None, "orig_target_sizes", (0, 1, 2))
    outputs = [np.array([[bad, 2]]), np.array([[[1, 2, 30, 40.0]] * 2]), np.array([[0.9, 0.8]])]
    (found,) = layout.read(outputs, [SIZE], 0.5)
    assert found.score.tolist() == [0.8]
