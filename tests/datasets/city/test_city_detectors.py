"""How real the city looks to detectors that were trained on photographs (COCO): figures, not a bar."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.city.conditions import condition
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName
from fbench.datasets.city.suite import SEEDS
from fbench.pipelines.camera.detector import CameraDetections, CameraDetector, CameraParams
from fbench.replay.arrays import Array, Bool
from fbench.replay.data import VEHICLES, Boxes2D, Image, Truth
from fbench.replay.geometry.boxes import iou_2d
from fbench.replay.images import decode

NEAR_M, SEEN, IOU, SCORE = 30.0, 0.5, 0.5, 0.4
WEIGHTS = {
    "DEIMv2-Femto": "deimv2_femto/deimv2_hgnetv2_femto_coco.onnx",
    "YOLOX-Nano": "yolox_nano/yolox_nano.onnx",
}
SECONDS, NUM_SEEDS = 1.0, 1
"""More of both give firmer figures."""
WORLDS: tuple[WorldName, ...] = ("urban", "highway")


def mono_log(world: WorldName, seed: int) -> tuple[dict[int, Image], dict[int, Boxes2D]]:
    """Images and truth, by stamp."""
    rig = RigSpec(cameras={"camera": thesis_rig().cameras["camera"]})
    log = CityRecording(CitySpec(world, condition("clear"), seconds=SECONDS, seed=seed, rig=rig), "log")
    images: dict[int, Image] = {}
    truth: dict[int, Boxes2D] = {}
    for item in log.items():
        if isinstance(item, Image):
            images[item.stamp_ns] = item
        elif isinstance(item, Truth) and item.boxes2d is not None:
            truth[item.stamp_ns] = item.boxes2d
    return images, truth


def is_vehicle(label: Array) -> Bool:
    return np.isin(label, sorted(VEHICLES))


def matches(found: CameraDetections, truth: Boxes2D) -> Counter[str]:
    """How many near vehicles are found, and how many detections of vehicles show one, ignored ones included."""
    assert truth.visible_xyxy_px is not None
    assert truth.distance_m is not None
    assert truth.visibility is not None
    assert truth.ignore is not None
    boxes, vehicle = found.xyxy_px[is_vehicle(found.label)], is_vehicle(truth.label)
    near = vehicle & (truth.distance_m < NEAR_M) & (truth.visibility >= SEEN) & ~truth.ignore
    if not len(boxes):
        return Counter(near=int(near.sum()))
    full, part = iou_2d(truth.xyxy_px, boxes), iou_2d(truth.visible_xyxy_px, boxes)
    overlap = np.maximum(full, part) >= IOU
    right = overlap[vehicle].any(axis=0)
    return Counter(near=int(near.sum()), found=int(overlap[near].any(axis=1).sum()), detections=len(boxes),
                   right=int(right.sum()))  # fmt: skip


def figures(name: str, c: Counter[str]) -> str:
    recall, precision = c["found"] / max(1, c["near"]), c["right"] / max(1, c["detections"])
    shares = f"{c['found']}/{c['near']} near vehicles, precision {c['right']}/{c['detections']}"
    return f"\n{name}: recall {recall:.2f}, precision {precision:.2f} ({shares})"


@pytest.mark.slow
def test_detectors_find_some_near_vehicles(shared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    detectors = {n: CameraDetector(CameraParams(shared / "weights" / f, SCORE)) for n, f in WEIGHTS.items()}
    counts = {(name, world): Counter[str]() for name in detectors for world in WORLDS}
    for world in WORLDS:
        for seed in SEEDS["dev"][:NUM_SEEDS]:
            images, truth = mono_log(world, seed)
            for stamp_ns, image in images.items():
                pixels = decode(image)
                for name, detector in detectors.items():
                    found = detector.infer(detector.prepare(pixels))
                    counts[name, world] += matches(found, truth[stamp_ns])
    with capsys.disabled():
        sys.stdout.writelines(figures(f"{name}, {world}", c) for (name, world), c in counts.items())
    for name in detectors:
        total = counts[name, "urban"] + counts[name, "highway"]
        assert total["found"] >= 0.3 * total["near"] > 0
        assert total["right"] >= 0.7 * total["detections"] > 0
