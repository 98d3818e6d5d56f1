"""Which classes of a model mean which label of fbench; all others are dropped."""

import ast
from collections.abc import Mapping

import numpy as np

from fbench.replay.arrays import Bool, Int64, Text
from fbench.replay.data import LABELS
from fbench.replay.errors import ModelError

MAX_CLASS = 1_000_000
"""Largest class id that is believed."""

ClassLabels = Mapping[int, str]

COCO_80: ClassLabels = {0: "pedestrian", 1: "bicycle", 2: "car", 3: "motorcycle", 5: "bus", 7: "truck"}
"""The 80 COCO classes numbered without gaps, as YOLO and DETR exports do."""
COCO_91: ClassLabels = {1: "pedestrian", 2: "bicycle", 3: "car", 4: "motorcycle", 6: "bus", 8: "truck"}
"""COCO's own category ids, as torchvision uses them (0 is the background)."""

_SYNONYMS = {"person": "pedestrian", "motorbike": "motorcycle", "bike": "bicycle", "cyclist": "bicycle"}


def labels_by_name(names: Mapping[int, str]) -> ClassLabels:
    """Translate class names to labels.

    Raises:
        ModelError: where no class is one that fbench knows.
    """
    lowered = {index: name.strip().lower() for index, name in names.items()}
    labels = {index: _SYNONYMS.get(name, name) for index, name in lowered.items()}
    known = {index: label for index, label in sorted(labels.items()) if label in LABELS}
    if not known:
        some = ", ".join(repr(name) for name in list(lowered.values())[:5])
        raise ModelError(f"no class of the model is a road user (its names begin with {some})")
    return known


def parse_names(text: str) -> dict[int, str]:
    """Read the `names` entry of Ultralytics metadata: a Python dict or list, written as text.

    Raises:
        ModelError: where it is anything else.
    """
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError) as error:
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
