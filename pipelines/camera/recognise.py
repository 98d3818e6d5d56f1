"""Tells from a model's header to which family it belongs."""

import math
from collections.abc import Mapping

from fbench.pipelines.camera.classes import COCO_80, COCO_91, ClassLabels, labels_by_name, parse_names
from fbench.pipelines.camera.detr import Detr
from fbench.pipelines.camera.layouts import SIDE_PX, Layout, ModelHeader, Port, Size
from fbench.pipelines.camera.torchvision import Torchvision
from fbench.pipelines.camera.ultralytics import Ultralytics
from fbench.pipelines.camera.yolox import YoloX
from fbench.replay.errors import ModelError

DEFAULT_SIDE_PX = 640
STRIDES = ((8, 16, 32), (8, 16, 32, 64))
MAX_CALL_PX = 1 << 26
"""Pixels of all images of one call: 800 MB as float32."""
_FLOATS = ("tensor(float)",)


def recognise(header: ModelHeader, input_wh: Size | None = None) -> Layout:
    """Return the layout of a model; `input_wh` sets the input's size where the header leaves it free.

    Raises:
        ModelError: where inputs or outputs aren't understood, or `input_wh` contradicts the header.
    """
    image = _image_input(header)
    _check_size(image, input_wh or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX))
    outputs = {port.name.lower(): i for i, port in enumerate(header.outputs)}
    size_input = [port for port in header.inputs if port.name == "orig_target_sizes"]
    order = _order(outputs) or _torchvision_order(header)
    if order and size_input and len(header.inputs) == 2 and len(image.shape) == 4:
        size = _size(image, input_wh) or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
        labels = _labels(header.metadata, COCO_80)
        return Detr(image.name, size_input[0].name, order, size, labels, image.shape[0])
    if order and len(header.inputs) == 1:
        return _torchvision(header, image, order, input_wh)
    if len(header.inputs) == 1 and len(header.outputs) == 1 and len(header.outputs[0].shape) == 3:
        return _yolo(header, image, header.outputs[0].shape, input_wh)
    raise ModelError(f"outputs aren't understood: {describe(header)}")


def describe(header: ModelHeader) -> str:
    """Inputs and outputs with their shapes, in one line."""
    return f"inputs {_ports(header.inputs)}, outputs {_ports(header.outputs)}"


def _ports(ports: tuple[Port, ...]) -> str:
    return ", ".join(f"{p.name} ({', '.join('?' if s is None else str(s) for s in p.shape)})" for p in ports[:6])


def _image_input(header: ModelHeader) -> Port:
    images = [p for p in header.inputs if len(p.shape) in (3, 4) and p.dtype in _FLOATS and p.shape[-3] in (3, None)]
    if len(images) != 1:
        raise ModelError(f"expected one float32 image input (B, 3, H, W): {describe(header)}")
    return images[0]


def _size(image: Port, input_wh: Size | None) -> Size | None:
    height, width = image.shape[-2:]
    if width is None or height is None:
        return input_wh
    if input_wh is not None and input_wh != (width, height):
        raise ModelError(f"the model's input is fixed to {width}x{height}, so it can't be {input_wh[0]}x{input_wh[1]}")
    return width, height


def _check_size(image: Port, free_wh: Size) -> None:
    """Refuse headers whose input would fill the memory, or hold nothing."""
    batch = (image.shape[:-3] or (1,))[0]
    height, width = image.shape[-2:]
    sides = [free_wh[0] if width is None else width, free_wh[1] if height is None else height]
    low, high = SIDE_PX
    if not all(low <= side <= high for side in sides):
        raise ModelError(f"expected an input of {low} to {high} px a side, its header says {_ports((image,))}")
    if batch is not None and not 1 <= batch * math.prod(sides) <= MAX_CALL_PX:
        raise ModelError(f"expected an input of at most {MAX_CALL_PX} px, its header says {_ports((image,))}")


def _labels(metadata: Mapping[str, str], default: ClassLabels) -> ClassLabels:
    return labels_by_name(parse_names(metadata["names"])) if "names" in metadata else default


def _order(outputs: Mapping[str, int]) -> tuple[int, int, int] | None:
    if len(outputs) != 3 or not {"labels", "boxes", "scores"} <= set(outputs):
        return None
    return outputs["labels"], outputs["boxes"], outputs["scores"]


def _torchvision_order(header: ModelHeader) -> tuple[int, int, int] | None:
    """Find labels, boxes and scores by shape and type, since exports often have numbers for names."""
    kinds = [(len(p.shape), p.dtype) for p in header.outputs]
    wanted = ((1, "tensor(int64)"), (2, "tensor(float)"), (1, "tensor(float)"))
    if sorted(kinds) != sorted(wanted) or header.outputs[kinds.index(wanted[1])].shape[1] not in (4, None):
        return None
    return kinds.index(wanted[0]), kinds.index(wanted[1]), kinds.index(wanted[2])


def _torchvision(header: ModelHeader, image: Port, order: tuple[int, int, int], input_wh: Size | None) -> Torchvision:
    if len(header.outputs[order[1]].shape) != 2:
        raise ModelError(f"outputs aren't understood: {describe(header)}")
    size = _size(image, input_wh)
    return Torchvision(image.name, size, len(image.shape) == 4, order, _labels(header.metadata, COCO_91))


def _yolo(header: ModelHeader, image: Port, shape: tuple[int | None, ...], input_wh: Size | None) -> Layout:
    """Tell the YOLO families apart: by the number of columns, and of boxes a cell."""
    size = _size(image, input_wh) or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
    labels, batch = _labels(header.metadata, COCO_80), image.shape[0]
    named = "names" in header.metadata
    classes = len(parse_names(header.metadata["names"])) if named else 80
    _, rows, columns = shape
    if rows == 4 + classes:
        return Ultralytics(image.name, size, "classes", labels, batch)
    if columns == 6 and named and classes != 1:
        return Ultralytics(image.name, size, "final", labels, batch)
    boxes_a_cell = [(rows or 0) / _cells(size, strides) for strides in STRIDES]
    if columns == 5 + classes and 1 in boxes_a_cell:
        return YoloX(image.name, size, STRIDES[boxes_a_cell.index(1)], labels, batch)
    if columns == 5 + classes and (3 in boxes_a_cell or named):
        return Ultralytics(image.name, size, "objectness", labels, batch)
    raise ModelError(f"outputs aren't understood for {classes} classes: {describe(header)}")


def _cells(size: Size, strides: tuple[int, ...]) -> int:
    return sum((size[0] // s) * (size[1] // s) for s in strides)
