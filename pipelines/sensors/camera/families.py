"""Families of camera detectors (YOLO, YOLOX, DETR, torchvision), recognized from a model's header."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, TypeAlias

import numpy as np

from fbench.pipelines.sensors.camera import layouts
from fbench.pipelines.sensors.camera.layouts import Candidates, ClassLabels, ModelHeader, Placement, Port, Size
from fbench.replay.contracts.errors import ModelError
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.images import Pixels


def _fit(images: Sequence[Pixels], placements: Sequence[Placement], input_wh: Size, *, bgr: bool = False) -> Array:
    """Scale images (H, W, 3) BGR into an input (B, 3, H, W): RGB 0..1, or BGR 0..255."""
    placed = [layouts.place(image, how, input_wh) for image, how in zip(images, placements, strict=True)]
    return layouts.planes(placed, rgb=not bgr, unit=not bgr)


def _sizes(images: Sequence[Pixels]) -> list[Size]:
    return [(image.shape[1], image.shape[0]) for image in images]


@dataclass(frozen=True)
class Layout(ABC):
    """One family of models."""

    family: ClassVar[str]
    image_input: str  # Name of the input for images
    input_wh: Size | None  # Width and height of the input [px]; `None`: any
    labels: ClassLabels
    batch: int | None  # How many images each call takes; `None`: the header leaves it free

    @abstractmethod
    def placement(self, size_wh: Size) -> Placement:
        """Where an image of this size lies in the input."""

    @abstractmethod
    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Fit images (H, W, 3) BGR into the model's inputs."""

    @abstractmethod
    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Boxes of each image with at least `min_score`, in pixels from that image's upper left corner."""


@dataclass(frozen=True)
class Detr(Layout):
    """Inputs `images` (B, 3, H, W) RGB 0..1, squashed, and `orig_target_sizes` (B, 2) width, height. Outputs `labels`
    (B, N), `boxes` (B, N, 4) left, top, right, bottom, `scores` (B, N).
    """

    family = "DETR"
    input_wh: Size
    size_input: str  # Name of the input for sizes
    output_order: tuple[int, int, int]  # Where labels, boxes and scores stand among the outputs

    def placement(self, size_wh: Size) -> Placement:
        """Fill the input."""
        return layouts.squash(size_wh, self.input_wh)

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Squash each image into the input, whatever its aspect ratio."""
        sizes = _sizes(images)
        placed = _fit(images, [self.placement(size) for size in sizes], self.input_wh)
        return {self.image_input: placed, self.size_input: np.array(sizes, np.int64).reshape(-1, 2)}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Take the boxes as they are: they are in pixels of the source already."""
        label, xyxy, score = (outputs[i] for i in self.output_order)
        return [layouts.select(xyxy[i], score[i], label[i], self.labels, min_score) for i in range(len(sizes_wh))]


@dataclass(frozen=True)
class Torchvision(Layout):
    """Input (3, H, W) or (1, 3, H, W) RGB 0..1; outputs boxes (N, 4) in input pixels, labels (N,), scores (N,)."""

    family = "torchvision"
    batch_axis: bool
    output_order: tuple[int, int, int]  # Where labels, boxes and scores stand among the outputs

    def placement(self, size_wh: Size) -> Placement:
        """Fill the input."""
        return layouts.squash(size_wh, self.input_wh or size_wh)

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Feed one image, squashed only where the model's input has a fixed size."""
        (size,) = _sizes(images[:1])
        wanted = self.input_wh or size
        fitted = images[0] if size == wanted else layouts.place(images[0], self.placement(size), wanted)
        values = layouts.planes([fitted], rgb=True, unit=True)
        return {self.image_input: values if self.batch_axis else values[0]}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Move the boxes back to the image."""
        label, xyxy, score = (outputs[i] for i in self.output_order)
        boxes = layouts.select(xyxy, score, label, self.labels, min_score)
        return [self.placement(sizes_wh[0]).back(boxes)]


@dataclass(frozen=True)
class _Letterboxed(Layout):
    input_wh: Size
    centered: ClassVar[bool]  # Whether images are in the middle of an input RGB 0..1, or upper left in BGR 0..255

    def placement(self, size_wh: Size) -> Placement:
        """Keep the aspect ratio."""
        return layouts.letterbox(size_wh, self.input_wh, centered=self.centered)

    def feeds(self, images: Sequence[Pixels]) -> dict[str, Array]:
        """Letterbox each image to its place in the input."""
        placements = [self.placement(size) for size in _sizes(images)]
        return {self.image_input: _fit(images, placements, self.input_wh, bgr=not self.centered)}

    def read(self, outputs: Sequence[Array], sizes_wh: Sequence[Size], min_score: float) -> list[Candidates]:
        """Move the boxes back to each image."""
        images = zip(outputs[0], sizes_wh, strict=True)
        return [self.placement(size).back(self._boxes(raw, min_score)) for raw, size in images]

    @abstractmethod
    def _boxes(self, raw: Array, min_score: float) -> Candidates: ...


Head: TypeAlias = Literal["objectness", "classes", "final"]
"""What the rows hold: cx, cy, w, h, objectness, classes (YOLOv5: (B, N, 5 + classes)); cx, cy, w, h, classes
(YOLOv8 and later: (B, 4 + classes, N)); left, top, right, bottom, score, class (NMS inside the model: (B, N, 6))."""


@dataclass(frozen=True)
class Ultralytics(_Letterboxed):
    """Input (B, 3, H, W) RGB 0..1, letterboxed to the middle; one output, see `Head`."""

    family = "Ultralytics"
    head: Head
    centered = True

    def _boxes(self, raw: Array, min_score: float) -> Candidates:
        if self.head == "classes":  # where it is quickly told, only rows that score enough, mostly few
            raw = raw[:, np.asarray(raw[4:].max(axis=0), np.float64) >= min_score].T
        rows = np.asarray(raw, np.float64)
        rows = rows[layouts.usable(rows)]
        if self.head == "final":
            return layouts.select(rows[:, :4], rows[:, 4], np.rint(rows[:, 5]), self.labels, min_score)
        class_scores = rows[:, 5:] * rows[:, 4:5] if self.head == "objectness" else rows[:, 4:]
        class_id = np.argmax(class_scores, axis=1)
        score = np.take_along_axis(class_scores, class_id[:, None], axis=1)[:, 0]
        return layouts.select(layouts.corners_of(rows), score, class_id, self.labels, min_score)


@dataclass(frozen=True)
class YoloX(_Letterboxed):
    """Input (B, 3, H, W) BGR 0..255, letterboxed to the upper left; output (B, cells, 5 + classes)."""

    family = "YOLOX"
    strides: tuple[int, ...]
    centered = False

    def _boxes(self, raw: Array, min_score: float) -> Candidates:
        raw = np.asarray(raw, np.float64)
        # Centers reach all parts of the input where the export did the grid's arithmetic itself (YOLOX's
        # `--decode_in_inference`); plain outputs stay within a few cells.
        is_decoded = (raw[:, :2].max(axis=0) > np.array(self.input_wh) / 2).all()
        likely = layouts.usable(raw) & (raw[:, 4] >= min_score)
        raw, cells = raw[likely], grid(self.input_wh, self.strides)[likely]
        xyxy = layouts.corners_of(raw if is_decoded else decode_grid(raw[:, :4], cells))
        class_id = np.argmax(raw[:, 5:], axis=1)
        score = raw[:, 4] * np.take_along_axis(raw[:, 5:], class_id[:, None], axis=1)[:, 0]
        return layouts.select(xyxy, score, class_id, self.labels, min_score)


@cache
def grid(input_wh: Size, strides: tuple[int, ...]) -> Float64:
    """Column, row and stride (cells, 3) of every cell, row by row, level by level."""
    levels = []
    for stride in strides:
        rows, columns = np.mgrid[0 : input_wh[1] // stride, 0 : input_wh[0] // stride]
        levels.append(np.stack([columns.ravel(), rows.ravel(), np.full(rows.size, stride)], axis=1))
    return np.concatenate(levels).astype(np.float64)


def decode_grid(raw: Float64, cells: Float64) -> Float64:
    """Center and size (N, 4) [input px]: (offset + cell) * stride, exp(size) * stride (YOLOX, arXiv 2107.08430)."""
    stride = cells[:, 2:3]
    # An exponent of 20 is far beyond any image; more would overflow on damaged weights.
    size = np.exp(np.minimum(raw[:, 2:4], 20.0)) * stride
    return np.concatenate([(raw[:, :2] + cells[:, :2]) * stride, size], axis=1)


DEFAULT_SIDE_PX = 640
STRIDES = ((8, 16, 32), (8, 16, 32, 64))
MAX_CALL_PX = 1 << 26  # Pixels of all images of one call: 800 MB as float32
_FLOATS = ("tensor(float)",)


RGB, RGBD = 3, 5  # Channels of images, and with what LiDARs and radars measured
_OTHERS = {
    RGB: (RGBD, "; it looks at points, too: name it as rgbd.weights"),
    RGBD: (RGB, "; it looks at images alone: name it as camera.weights"),
}


def recognize(header: ModelHeader, input_wh: Size | None = None, channels: int = RGB) -> Layout:
    """Return the layout of a model; `input_wh` sets the input's size where the header leaves it free. Raises ModelError
    where inputs or outputs aren't understood, or `input_wh` contradicts the header. With `RGBD` channels only
    `Ultralytics` is.
    """
    inputs = [port for port in header.inputs if len(port.shape) in (3, 4) and port.dtype in _FLOATS]
    images = [port for port in inputs if port.shape[-3] in ((RGB, None) if channels == RGB else (channels,))]
    if len(images) != 1:
        other, hint = _OTHERS[channels]
        hint = hint if [port.shape[-3] for port in inputs] == [other] else ""
        raise ModelError(f"expected one float32 image input (B, {channels}, H, W): {describe(header)}{hint}")
    image = images[0]
    layout = _recognize(header, image, input_wh)
    if channels != RGB and not isinstance(layout, Ultralytics):
        raise ModelError(f"outputs aren't understood: {describe(header)}")
    return layout


def _recognize(header: ModelHeader, image: Port, input_wh: Size | None) -> Layout:
    _check_size(image, input_wh or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX))
    size_input = [port for port in header.inputs if port.name == "orig_target_sizes"]
    order = _order(header)
    if order and size_input and len(header.inputs) == 2 and len(image.shape) == 4:
        size = _size(image, input_wh) or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
        labels = _labels(header.metadata, layouts.COCO_80)
        return Detr(image.name, size, labels, image.shape[0], size_input[0].name, order)
    if order and len(header.inputs) == 1:
        if len(header.outputs[order[1]].shape) != 2:
            raise ModelError(f"outputs aren't understood: {describe(header)}")
        labels = _labels(header.metadata, layouts.COCO_91)
        return Torchvision(image.name, _size(image, input_wh), labels, 1, len(image.shape) == 4, order)
    if len(header.inputs) == 1 and len(header.outputs) == 1 and len(header.outputs[0].shape) == 3:
        return _yolo(header, image, header.outputs[0].shape, input_wh)
    raise ModelError(f"outputs aren't understood: {describe(header)}")


def describe(header: ModelHeader) -> str:
    """Inputs and outputs with their shapes, in one line."""
    return f"inputs {_ports(header.inputs)}, outputs {_ports(header.outputs)}"


def _ports(ports: tuple[Port, ...]) -> str:
    return ", ".join(f"{p.name} ({', '.join('?' if s is None else str(s) for s in p.shape)})" for p in ports[:6])


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
    low, high = layouts.SIDE_PX
    if not all(low <= side <= high for side in sides):
        raise ModelError(f"expected an input of {low} to {high} px a side, its header says {_ports((image,))}")
    if batch is not None and not 1 <= batch * math.prod(sides) <= MAX_CALL_PX:
        raise ModelError(f"expected an input of at most {MAX_CALL_PX} px, its header says {_ports((image,))}")


def _labels(metadata: Mapping[str, str], default: ClassLabels) -> ClassLabels:
    return layouts.labels_by_name(layouts.parse_names(metadata["names"])) if "names" in metadata else default


def _order(header: ModelHeader) -> tuple[int, int, int] | None:
    """Find labels, boxes and scores by name, else by shape and type, since exports often have numbers for names."""
    outputs = {port.name.lower(): i for i, port in enumerate(header.outputs)}
    if len(outputs) == 3 and set(outputs) == {"labels", "boxes", "scores"}:
        return outputs["labels"], outputs["boxes"], outputs["scores"]
    kinds = [(len(p.shape), p.dtype) for p in header.outputs]
    wanted = ((1, "tensor(int64)"), (2, "tensor(float)"), (1, "tensor(float)"))
    if sorted(kinds) != sorted(wanted) or header.outputs[kinds.index(wanted[1])].shape[1] not in (4, None):
        return None
    return kinds.index(wanted[0]), kinds.index(wanted[1]), kinds.index(wanted[2])


def _yolo(header: ModelHeader, image: Port, shape: tuple[int | None, ...], input_wh: Size | None) -> Layout:
    """Tell the YOLO families apart: by the number of columns, and of boxes a cell."""
    size = _size(image, input_wh) or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
    common = image.name, size, _labels(header.metadata, layouts.COCO_80), image.shape[0]
    named = "names" in header.metadata
    classes = len(layouts.parse_names(header.metadata["names"])) if named else 80
    _, rows, columns = shape
    if rows == 4 + classes:
        return Ultralytics(*common, "classes")
    if columns == 6 and named and classes != 1:
        return Ultralytics(*common, "final")
    boxes_a_cell = [(rows or 0) / sum((size[0] // s) * (size[1] // s) for s in strides) for strides in STRIDES]
    if columns == 5 + classes and 1 in boxes_a_cell:
        return YoloX(*common, STRIDES[boxes_a_cell.index(1)])
    if columns == 5 + classes and (3 in boxes_a_cell or named):
        return Ultralytics(*common, "objectness")
    raise ModelError(f"outputs aren't understood for {classes} classes: {describe(header)}")
