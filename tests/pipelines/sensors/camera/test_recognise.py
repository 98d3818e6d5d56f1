import pytest

from fbench.pipelines.sensors.camera.families import Detr, Torchvision, Ultralytics, YoloX, recognize
from fbench.pipelines.sensors.camera.layouts import ModelHeader, Port
from fbench.replay.contracts.errors import ModelError

F, I = "tensor(float)", "tensor(int64)"  # noqa: E741
Shape = tuple[int | None, ...]
THREE_NAMES = {"names": "{0: 'person', 1: 'car', 2: 'kite'}"}


def yolo(shape: Shape, image: Shape = (1, 3, 416, 416), metadata: dict[str, str] | None = None) -> ModelHeader:
    return ModelHeader((Port("images", F, image),), (Port("output0", F, shape),), metadata or {})


def test_detr() -> None:
    outputs = (Port("labels", I, (None, 300)), Port("boxes", F, (None, 300, 4)), Port("scores", F, (None, 300)))
    inputs = (Port("images", F, (None, 3, 416, 416)), Port("orig_target_sizes", I, (None, 2)))
    layout = recognize(ModelHeader(inputs, outputs, {}))
    assert isinstance(layout, Detr)
    assert layout.input_wh == (416, 416)
    assert layout.output_order == (0, 1, 2)
    assert layout.batch is None


def test_yolox_has_one_box_a_cell_and_yolov5_three() -> None:
    yolox = recognize(yolo((1, 3549, 85)))
    assert isinstance(yolox, YoloX)
    assert yolox.strides == (8, 16, 32)
    yolov5 = recognize(yolo((1, 3 * 3549, 85)))
    assert isinstance(yolov5, Ultralytics)
    assert yolov5.head == "objectness"


def test_four_levels() -> None:
    cells = sum((1280 // s) ** 2 for s in (8, 16, 32, 64))
    layout = recognize(yolo((1, cells, 85), image=(1, 3, 1280, 1280)))
    assert isinstance(layout, YoloX)
    assert layout.strides == (8, 16, 32, 64)


def test_yolov8_with_and_without_names() -> None:
    plain = recognize(yolo((1, 84, 3549)))
    assert isinstance(plain, Ultralytics)
    assert plain.head == "classes"
    assert plain.labels[2] == "car"
    named = recognize(yolo((1, 7, 3549), metadata=THREE_NAMES))
    assert isinstance(named, Ultralytics)
    assert named.labels == {0: "pedestrian", 1: "car"}


def test_yolov5_with_names_and_free_size() -> None:
    layout = recognize(yolo((None, None, 8), image=(1, 3, None, None), metadata=THREE_NAMES), (320, 192))
    assert isinstance(layout, Ultralytics)
    assert layout.head == "objectness"
    assert layout.input_wh == (320, 192)


def test_yolo_with_nms_inside() -> None:
    layout = recognize(yolo((1, 300, 6), metadata=THREE_NAMES))
    assert isinstance(layout, Ultralytics)
    assert layout.head == "final"


def test_free_size_without_a_request_is_640() -> None:
    layout = recognize(yolo((1, 84, None), image=(None, 3, None, None)))
    assert isinstance(layout, Ultralytics)
    assert layout.input_wh == (640, 640)


@pytest.mark.parametrize("names", [("boxes", "labels", "scores"), ("2859", "2860", "2861")])
def test_torchvision_by_names_or_by_shapes(names: tuple[str, str, str]) -> None:
    outputs = (Port(names[0], F, (None, 4)), Port(names[1], I, (None,)), Port(names[2], F, (None,)))
    layout = recognize(ModelHeader((Port("image", F, (3, None, None)),), outputs, {}))
    assert isinstance(layout, Torchvision)
    assert (layout.input_wh, layout.batch_axis, layout.output_order) == (None, False, (1, 0, 2))
    assert layout.labels[3] == "car"


@pytest.mark.parametrize(
    ("header", "match"),
    [
        (yolo((1, 1000)), r"outputs aren't understood: inputs images \(1, 3, 416, 416\), outputs output0 \(1, 1000\)"),
        (yolo((1, 1234, 85)), "outputs aren't understood for 80 classes"),
        (yolo((1, 84, 3549), metadata=THREE_NAMES), "outputs aren't understood for 3 classes"),
        (yolo((1, 84, 3549), metadata={"names": "open('x')"}), "isn't a dict or list of class names"),
        (yolo((1, 84, 3549), image=(1, 10)), r"expected one float32 image input \(B, 3, H, W\)"),
        (ModelHeader((), (), {}), "expected one float32 image input"),
    ],
)
def test_what_is_not_understood(header: ModelHeader, match: str) -> None:
    with pytest.raises(ModelError, match=match):
        recognize(header)


@pytest.mark.parametrize("side", [0, -1, 31, 8193, 100000])
def test_inputs_of_absurd_size_are_refused(side: int) -> None:
    with pytest.raises(ModelError, match=rf"32 to 8192 px a side, its header says images \(1, 3, {side}, {side}\)"):
        recognize(yolo((1, 84, None), image=(1, 3, side, side)))
    with pytest.raises(ModelError, match="32 to 8192 px a side"):
        recognize(yolo((1, 84, None), image=(1, 3, None, side)))


@pytest.mark.parametrize("batch", [0, -4, 1000])
def test_batches_of_absurd_size_are_refused(batch: int) -> None:
    with pytest.raises(ModelError, match=rf"at most 67108864 px, its header says images \({batch}, 3, 416, 416\)"):
        recognize(yolo((1, 84, None), image=(batch, 3, 416, 416)))
    with pytest.raises(ModelError, match="at most 67108864 px"):
        recognize(yolo((1, 84, None), image=(batch, 3, None, None)))


def test_a_fixed_size_cannot_be_changed() -> None:
    with pytest.raises(ModelError, match="the model's input is fixed to 416x416, so it can't be 640x640"):
        recognize(yolo((1, 84, 3549)), (640, 640))
