"""Make `coco.json`: what pycocotools 2.0.11 says about random boxes.

Run in an environment of its own (numpy 2.4.6, pycocotools 2.0.11):

    python -m venv /tmp/coco && /tmp/coco/bin/pip install numpy==2.4.6 pycocotools==2.0.11
    /tmp/coco/bin/python tests/metrics/profiles/coco/oracles/make_coco.py

The tests make the same boxes with `random_images` and compare.
"""

import contextlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

CLASSES = ("car", "bicycle", "person", "train", "boat")
"""Only estimates are boats; all trains are crowds."""
SEEDS = (1, 2, 3, 4, 5, 6)
SIZE_PX = 640


@dataclass(frozen=True)
class Boxes:
    """N boxes in images."""

    image: np.ndarray
    """(N,)"""
    label: np.ndarray
    """(N,) index in `CLASSES`."""
    xyxy: np.ndarray
    """(N, 4) in steps of 1/64 px, so that widths are exact."""
    score: np.ndarray
    """(N,) no two are equal."""
    crowd: np.ndarray
    """(N,)"""


def random_images(seed: int) -> tuple[int, Boxes, Boxes]:
    """Return the number of images, truth, and estimates; image 0 is empty, 1 has no truth, 2 very many estimates."""
    rng = np.random.Generator(np.random.PCG64(seed))
    num_images = 24 if seed > 1 else 3
    num = 10 * num_images
    image = rng.integers(2, num_images, num)
    label = rng.integers(0, 4, num)
    boxes = _boxes(rng, num)
    crowd = (rng.random(num) < 0.12) | (label == 3)
    truth = Boxes(image, label, boxes, np.zeros(num), crowd)
    found = np.repeat(np.arange(num), rng.integers(0, 4, num))
    near = _shaken(rng, boxes[found], 0.12)
    missed = 8 * num_images
    many = 260
    estimates = Boxes(
        np.concatenate([image[found], rng.integers(1, num_images, missed), np.full(many, 2)]),
        np.concatenate([label[found], rng.integers(0, 5, missed), np.repeat([0, 1], many // 2)]),
        np.concatenate([near, _boxes(rng, missed), _shaken(rng, boxes[rng.integers(0, num, many)], 0.3)]),
        rng.permutation(len(found) + missed + many) / 4096,
        np.zeros(len(found) + missed + many, bool),
    )
    return num_images, truth, estimates


def _boxes(rng: np.random.Generator, num: int) -> np.ndarray:
    size = np.exp(rng.uniform(np.log(8), np.log(250), (num, 2)))
    low = rng.uniform(0, SIZE_PX, (num, 2))
    return _gridded(np.hstack([low, low + size]))


def _shaken(rng: np.random.Generator, xyxy: np.ndarray, share: float) -> np.ndarray:
    size = xyxy[:, 2:] - xyxy[:, :2]
    shaken = xyxy + rng.normal(0, share, xyxy.shape) * rng.random((len(xyxy), 1)) * np.hstack([size, size])
    return _gridded(np.hstack([shaken[:, :2], np.maximum(shaken[:, 2:], shaken[:, :2] + 1)]))


def _gridded(xyxy: np.ndarray) -> np.ndarray:
    gridded: np.ndarray = np.round(xyxy * 64) / 64
    return gridded


def main() -> None:
    """Write the numbers beside this file."""
    path = Path(__file__).parent / "coco.json"
    path.write_text(json.dumps({str(seed): reference(seed) for seed in SEEDS}, indent=1) + "\n")


def reference(seed: int) -> dict[str, Any]:
    """Return the twelve numbers, and AP, AP50 and AP75 of each class; -1 where pycocotools has none."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    num_images, truth, estimates = random_images(seed)
    with contextlib.redirect_stdout(io.StringIO()):
        ground = COCO()
        ground.dataset = {
            "images": [{"id": i + 1} for i in range(num_images)],
            "categories": [{"id": i + 1, "name": name} for i, name in enumerate(CLASSES)],
            "annotations": _rows(truth),
        }
        ground.createIndex()
        results = ground.loadRes(_rows(estimates))
        evaluation = COCOeval(ground, results, "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    precision = evaluation.eval["precision"][:, :, :, 0, -1]
    return {
        "stats": evaluation.stats.tolist(),
        "classes": {
            name: [float(precision[rows, :, k].mean()) for rows in (slice(None), 0, 5)]
            for k, name in enumerate(CLASSES)
        },
    }


def _rows(boxes: Boxes) -> list[dict[str, Any]]:
    rows = []
    for i, (x0, y0, x1, y1) in enumerate(boxes.xyxy.tolist()):
        rows.append({
            "id": i + 1,
            "image_id": int(boxes.image[i]) + 1,
            "category_id": int(boxes.label[i]) + 1,
            "bbox": [x0, y0, x1 - x0, y1 - y0],
            "area": (x1 - x0) * (y1 - y0),
            "iscrowd": int(boxes.crowd[i]),
            "score": float(boxes.score[i]),
        })  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
