import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraDetector, CameraParams
from fbench.replay.contracts.errors import ConfigError, ModelError
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image

Model = Callable[..., Path]
PIXELS = np.zeros((100, 120, 3), np.uint8)
WEIGHTS = ("deimv2_femto/deimv2_hgnetv2_femto_coco.onnx", "yolox_nano/yolox_nano.onnx")


def detect(detector: CameraDetector, pixels: Pixels) -> CameraDetections:
    return detector.infer(detector.prepare(pixels))


def test_boxes_have_pixel_centers_at_integers_and_fall_in_score(one_car: Path) -> None:
    found = detect(CameraDetector(CameraParams(weights=one_car)), PIXELS)
    assert found.xyxy_px.tolist() == [[9.5, 19.5, 49.5, 59.5], [69.5, 19.5, 79.5, 59.5]]
    assert found.label.tolist() == ["car", "pedestrian"]
    np.testing.assert_allclose(found.score, [0.9, 0.8], rtol=1e-6)


def test_min_score_is_respected(one_car: Path) -> None:
    assert len(detect(CameraDetector(CameraParams(weights=one_car, min_score=0.05)), PIXELS)) == 3
    assert len(detect(CameraDetector(CameraParams(weights=one_car, min_score=0.95)), PIXELS)) == 0


def test_a_wide_image_is_looked_at_in_windows(one_car: Path) -> None:
    wide = np.zeros((100, 400, 3), np.uint8)
    detector = CameraDetector(CameraParams(weights=one_car))
    assert len(detector.prepare(wide).windows) == 4
    # The constant car appears once in the whole image and once in each window.
    cars = [box for box, label in zip(*_rows(detector, wide), strict=True) if label == "car"]
    assert sorted(box[0] for box in cars) == [9.5, 109.5, 209.5]
    whole = CameraDetector(CameraParams(weights=one_car, tiles=False))
    assert len(whole.prepare(wide).windows) == 1


def _rows(detector: CameraDetector, pixels: Pixels) -> tuple[list[list[float]], list[str]]:
    found = detect(detector, pixels)
    return found.xyxy_px.tolist(), found.label.tolist()


def test_no_weights_named() -> None:
    with pytest.raises(ConfigError, match=r"the camera needs a detector: --set camera\.weights=PATH"):
        CameraDetector(CameraParams())


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.onnx: weights can't be read \(No such file or directory\)"):
        CameraDetector(CameraParams(weights=tmp_path / "none.onnx"))


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x80\x04\x95pickle", b"\x08\x08", b"PK\x03\x04" * 9])
def test_not_onnx(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bad.onnx"
    path.write_bytes(data)
    with pytest.raises(ModelError, match=r"^\S*bad\.onnx: not an ONNX"):
        CameraDetector(CameraParams(weights=path))


def test_truncated(one_car: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.onnx"
    path.write_bytes(one_car.read_bytes()[:-40])
    with pytest.raises(ModelError, match=r"cut\.onnx: not an ONNX"):
        CameraDetector(CameraParams(weights=path))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("x" * 300 + ".onnx", "File name too long"),
        ("\0and-a-name.onnx", "null"),
        ("folder.onnx", "not a regular file"),
        ("fifo.onnx", "not a regular file"),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, name: str, reason: str) -> None:
    (tmp_path / "folder.onnx").mkdir()
    os.mkfifo(tmp_path / "fifo.onnx")
    with pytest.raises(ConfigError, match=rf"{name[-10:]}: weights can't be read \(.*{reason}"):
        CameraDetector(CameraParams(weights=tmp_path / name))


def test_weights_in_other_files_are_refused(constant_model: Model) -> None:
    path = constant_model(
        {"output": np.zeros((1, 84, 21), np.float32)}, {"images": ("float32", (1, 3, 32, 32))}, external=True
    )
    with pytest.raises(ModelError, match=r"the model keeps weights in other files, export it as one file"):
        CameraDetector(CameraParams(weights=path))


def test_outputs_that_are_not_understood(constant_model: Model) -> None:
    path = constant_model({"output": np.zeros((1, 1000), np.float32)}, {"images": ("float32", (1, 3, 32, 32))})
    with pytest.raises(ModelError, match=r"model\.onnx: outputs aren't understood") as error:
        CameraDetector(CameraParams(weights=path))
    assert "\n" not in str(error.value)


def test_a_model_that_fails_is_refused_when_it_is_loaded(constant_model: Model) -> None:
    # A header that claims YOLOX, and an output with fewer columns than it says, can't be told before.
    path = constant_model(
        {
            "labels": np.zeros((1, 2), np.int64),
            "boxes": np.zeros((1, 3, 4), np.float32),
            "scores": np.ones((1, 2), np.float32),
        },
        {"images": ("float32", (1, 3, 32, 32)), "orig_target_sizes": ("int64", (1, 2))},
    )
    with pytest.raises(ModelError, match=r"model\.onnx: the model failed"):
        CameraDetector(CameraParams(weights=path))


def batch_model(constant_model: Model, declared: int | str, num: int, side: int = 32) -> Path:
    """A graph that always gives the boxes of `num` images."""
    return constant_model(
        {
            "labels": np.full((num, 1), 2, np.int64),
            "boxes": np.tile(np.array([[[10, 20, 50, 60]]], np.float32), (num, 1, 1)),
            "scores": np.full((num, 1), 0.9, np.float32),
        },
        {"images": ("float32", (declared, 3, side, side)), "orig_target_sizes": ("int64", (declared, 2))},
    )


@pytest.mark.parametrize("num", [1, 2, 3, 4, 8])
def test_a_fixed_batch_is_filled_and_the_surplus_dropped(constant_model: Model, num: int) -> None:
    detector = CameraDetector(CameraParams(weights=batch_model(constant_model, num, num)))
    assert len(detect(detector, PIXELS)) == 1
    wide = detector.prepare(np.zeros((100, 400, 3), np.uint8))  # the whole and three windows
    assert [batch.num for batch in wide.batches] == {1: [1] * 4, 2: [2, 2], 3: [3, 1]}.get(num, [4])
    assert all(len(batch.feeds["images"]) == num for batch in wide.batches)
    assert len(detector.infer(wide)) == 3


def test_a_graph_for_one_image_under_a_free_header_gets_one_a_call(constant_model: Model) -> None:
    detector = CameraDetector(CameraParams(weights=batch_model(constant_model, "N", 1)))
    wide = detector.prepare(np.zeros((100, 400, 3), np.uint8))
    assert [len(batch.feeds["images"]) for batch in wide.batches] == [1] * 4
    assert len(detector.infer(wide)) == 3


@pytest.mark.slow
def test_a_free_batch_takes_all_windows_unless_they_are_too_large(constant_model: Model) -> None:
    pixels = np.zeros((100, 400, 3), np.uint8)
    small = CameraDetector(CameraParams(weights=batch_model(constant_model, "N", 4)))
    assert [batch.num for batch in small.prepare(pixels).batches] == [4]
    large = CameraDetector(CameraParams(weights=batch_model(constant_model, "N", 4, side=2048)))
    assert max(batch.num for batch in large.prepare(pixels).batches) <= 4
    huge = CameraDetector(CameraParams(weights=batch_model(constant_model, "N", 4, side=4096)))
    assert [batch.num for batch in huge.prepare(pixels).batches] == [1] * 4


@pytest.mark.parametrize("size", [(20000, 1), (1, 20000), (5000, 10)])
def test_strips_of_an_image_give_few_windows(one_car: Path, size: tuple[int, int]) -> None:
    prepared = CameraDetector(CameraParams(weights=one_car)).prepare(np.zeros((size[1], size[0], 3), np.uint8))
    assert len(prepared.windows) == 9
    assert len(prepared.batches) == 9


@pytest.mark.parametrize("damage", [b"not a model", b""])
def test_damaged_files_are_told_once_and_without_prints(
    one_car: Path, damage: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    data = one_car.read_bytes()
    one_car.write_bytes(data.replace(b"Identity", b"Idemtity") if damage else data[: len(data) // 2] + data[-30:])
    with pytest.raises(ModelError, match=r"model\.onnx: not an ONNX"):
        CameraDetector(CameraParams(weights=one_car))
    assert capfd.readouterr() == ("", "")


@pytest.fixture(scope="module")
def street(shared: Path) -> Pixels:
    data = (shared / "data/astyx/camera_front/000057.jpg").read_bytes()
    pixels = decode(Image("camera", 0, 0, data, "jpeg", (2048, 618)))
    assert pixels is not None
    return pixels


@pytest.mark.parametrize("weights", WEIGHTS)
def test_real_weights_find_the_car(shared: Path, street: Pixels, weights: str) -> None:
    found = detect(CameraDetector(CameraParams(weights=shared / "weights" / weights)), street)
    left, top, right, bottom = found.xyxy_px[0]
    assert found.label[0] == "car"
    # Read off the picture: the car on the right lane.
    np.testing.assert_allclose([left, top, right, bottom], [1216, 297, 1423, 450], atol=20)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_threads_and_repeats_change_no_bit(shared: Path, street: Pixels, weights: str) -> None:
    params = CameraParams(weights=shared / "weights" / weights, min_score=0.1)
    first = detect(CameraDetector(params), street)
    again = detect(CameraDetector(replace(params, threads=1)), street)
    assert len(first) > 5
    assert first.xyxy_px.tobytes() == again.xyxy_px.tobytes()
    assert first.score.tobytes() == again.score.tobytes()
    assert first.label.tolist() == again.label.tolist()
