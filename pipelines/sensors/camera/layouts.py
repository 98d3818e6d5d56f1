"""The contract of a model family: inputs, candidates, classes, and how images are fitted into the input."""

import ast
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from fbench.pipelines.sensors.rows import Rows
from fbench.replay.contracts.errors import ModelError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import LABELS
from fbench.replay.data.images import Pixels


@dataclass(frozen=True, eq=False)
class Candidates(Rows):
    """N boxes of one image. Coordinates here are distances from the image's upper left corner, so that the image spans
    0 to width and scaling an image scales its boxes.
    """

    xyxy: Float64  # (N, 4) left, top, right, bottom [px]
    score: Float64  # (N,) 0 to 1
    label: Text  # (N,) of `LABELS`

    def move(self, scale: tuple[float, float], offset: tuple[float, float]) -> "Candidates":
        """Return the boxes at scale * (x, y) + offset."""
        xyxy = self.xyxy * (scale * 2) + np.array(offset * 2)
        return Candidates(xyxy, self.score, self.label)

    def clip(self, size_wh: tuple[int, int]) -> "Candidates":
        """Cut boxes at the image's border and drop those that are empty or not finite."""
        xyxy = np.clip(self.xyxy, 0.0, np.array(size_wh * 2, np.float64))
        whole = (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1]) & np.isfinite(self.score)
        return Candidates(xyxy, self.score, self.label)[whole]


NO_CANDIDATES = Candidates(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U1"))
PAD_VALUE = 114  # Grey of the border, as YOLO models are trained


@dataclass(frozen=True)
class Placement:
    """Where an image lies in the input: input = scale * image + offset, in pixels from the upper left corner."""

    scale: tuple[float, float]
    offset: tuple[float, float]

    def back(self, boxes: Candidates) -> Candidates:
        """Move boxes from the input to the image."""
        (sx, sy), (x, y) = self.scale, self.offset
        return boxes.move((1 / sx, 1 / sy), (-x / sx, -y / sy))


def squash(size_wh: tuple[int, int], input_wh: tuple[int, int]) -> Placement:
    """Fill the whole input and let the aspect ratio go."""
    return Placement((input_wh[0] / size_wh[0], input_wh[1] / size_wh[1]), (0.0, 0.0))


def letterbox(size_wh: tuple[int, int], input_wh: tuple[int, int], *, centered: bool) -> Placement:
    """Keep the aspect ratio (to a rounded pixel); the border is on both sides or at right and bottom."""
    ratio = min(input_wh[0] / size_wh[0], input_wh[1] / size_wh[1])
    inner = [max(1, round(size * ratio)) for size in size_wh]
    space = [outer - size for outer, size in zip(input_wh, inner, strict=True)]
    x, y = (float(s // 2) if centered else 0.0 for s in space)
    return Placement((inner[0] / size_wh[0], inner[1] / size_wh[1]), (x, y))


def place(pixels: Pixels, placement: Placement, input_wh: tuple[int, int]) -> Pixels:
    """Scale `pixels` (H, W, 3) and paste them into an input-sized image with a grey border."""
    height, width = pixels.shape[:2]
    inner = (round(width * placement.scale[0]), round(height * placement.scale[1]))
    shrinks = inner[0] < width or inner[1] < height
    scaled = cv2.resize(pixels, inner, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    if inner == input_wh:
        return np.asarray(scaled, np.uint8)
    canvas = np.full((input_wh[1], input_wh[0], 3), PAD_VALUE, np.uint8)
    x, y = int(placement.offset[0]), int(placement.offset[1])
    canvas[y : y + inner[1], x : x + inner[0]] = scaled
    return canvas


def planes(images: list[Pixels], *, rgb: bool, unit: bool) -> np.ndarray:
    """Stack images (H, W, 3) BGR to (B, 3, H, W) float32, as RGB if asked, scaled to 0..1 if asked."""
    height, width = images[0].shape[:2]
    values = np.empty((len(images), 3, height, width), np.float32)
    factor = np.float32(1 / 255 if unit else 1)
    for image, own in zip(images, values, strict=True):
        channels = cv2.split(image)
        for channel, plane in zip(channels[::-1] if rgb else channels, own, strict=True):
            np.multiply(channel, factor, out=plane)
    return values


MAX_CLASS = 1_000_000  # Largest class id that is believed
ClassLabels = Mapping[int, str]
COCO_80: ClassLabels = {0: "pedestrian", 1: "bicycle", 2: "car", 3: "motorcycle", 5: "bus", 7: "truck"}
"""The 80 COCO classes numbered without gaps, as YOLO and DETR exports do."""
COCO_91: ClassLabels = {1: "pedestrian", 2: "bicycle", 3: "car", 4: "motorcycle", 6: "bus", 8: "truck"}
"""COCO's own category ids, as torchvision uses them (0 is the background)."""
_SYNONYMS = {"person": "pedestrian", "motorbike": "motorcycle", "bike": "bicycle", "cyclist": "bicycle"}


def labels_by_name(names: Mapping[int, str]) -> ClassLabels:
    """Translate class names to labels. Raises ModelError where no class is one that fbench knows."""
    lowered = {index: name.strip().lower() for index, name in names.items()}
    labels = {index: _SYNONYMS.get(name, name) for index, name in lowered.items()}
    known = {index: label for index, label in sorted(labels.items()) if label in LABELS}
    if not known:
        some = ", ".join(repr(name) for name in list(lowered.values())[:5])
        raise ModelError(f"no class of the model is a road user (its names begin with {some})")
    return known


def parse_names(text: str) -> dict[int, str]:
    """Read Ultralytics' entry `names`, a Python dict or list as text. Raises ModelError where it is anything else."""
    try:
        value = ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
        raise ModelError("metadata entry 'names' isn't a dict or list of class names") from error
    items = dict(enumerate(value)) if isinstance(value, list | tuple) else value
    if not isinstance(items, dict) or not items:
        raise ModelError("metadata entry 'names' isn't a dict or list of class names")
    if not all(isinstance(k, int) and isinstance(v, str) for k, v in items.items()):
        raise ModelError("metadata entry 'names' isn't a dict or list of class names")
    if not all(0 <= k <= MAX_CLASS for k in items):
        raise ModelError(f"metadata entry 'names': class ids must be between 0 and {MAX_CLASS}")
    return items


def translate(class_id: Int64, labels: ClassLabels) -> tuple[Text, Bool]:
    """Return labels (N,) and a mask (N,) of the classes that have one."""
    ids = np.array(sorted(labels), np.int64)
    texts = np.array([labels[int(i)] for i in ids], dtype="U16")
    at = np.clip(np.searchsorted(ids, class_id), 0, len(ids) - 1)
    known: Bool = ids[at] == class_id
    return texts[at], known


Size = tuple[int, int]
SIDE_PX = (32, 8192)  # Shortest and longest side of an input that is believed
_MAX_PX = 1e12


@dataclass(frozen=True)
class Port:
    """One input or output of a model, as its header describes it."""

    name: str
    dtype: str  # As onnxruntime writes it, for example `tensor(float)`
    shape: tuple[int | None, ...]  # `None` where the header leaves the size free


@dataclass(frozen=True)
class ModelHeader:
    """What a model says about itself."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    metadata: Mapping[str, str]


def select(xyxy: Array, score: Array, class_id: Array, labels: ClassLabels, min_score: float) -> Candidates:
    """Keep finite boxes (N, 4) with a known class (N,) and enough score (N,)."""
    ids = np.nan_to_num(class_id, nan=-1.0)
    text, known = translate(np.where(np.abs(ids) <= MAX_CLASS, ids, -1).astype(np.int64), labels)
    boxes, scores = np.asarray(xyxy, np.float64), np.asarray(score, np.float64)
    keep = known & (scores >= min_score) & np.isfinite(scores) & usable(boxes)
    return Candidates(boxes[keep], scores[keep], text[keep])


def usable(rows: Array) -> Bool:
    """Tell which rows (N, M) hold numbers with which the arithmetic of boxes neither overflows nor gives NaN."""
    magnitude = np.abs(np.nan_to_num(rows, nan=np.inf))
    return np.asarray((magnitude < _MAX_PX).all(axis=1), np.bool_)


def corners_of(cxcywh: Array) -> Array:
    """Turn center and size (N, 4) into left, top, right, bottom."""
    center, half = cxcywh[:, :2], cxcywh[:, 2:4] / 2
    return np.concatenate([center - half, center + half], axis=1)
