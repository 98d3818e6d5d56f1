"""Recall of detectors that were trained on photographs (COCO) on near vehicles of the city."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from common import images_and_truth

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import SEEDS
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName, condition
from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraDetector, CameraParams
from fbench.replay.data.arrays import Array, Bool
from fbench.replay.data.boxes import VEHICLES, Boxes2D
from fbench.replay.data.images import decode
from fbench.replay.geometry.iou import iou_2d

SHARED = Path(__file__).resolve().parents[2] / "shared"
NEAR_M, SEEN, IOU, SCORE = 30.0, 0.5, 0.5, 0.4
"""Vehicles count within this distance and where at least so much of them is visible."""
WEIGHTS = {"DEIMv2-Femto": "deimv2_femto/deimv2_hgnetv2_femto_coco.onnx", "YOLOX-Nano": "yolox_nano/yolox_nano.onnx"}
WORLDS: tuple[WorldName, ...] = ("urban", "highway")
SECONDS, NUM_SEEDS = 2.0, 4
Counts: TypeAlias = dict[tuple[str, WorldName], Counter[str]]  # By detector and world


def is_vehicle(label: Array) -> Bool:
    return np.isin(label, sorted(VEHICLES))


def matches(found: CameraDetections, truth: Boxes2D) -> Counter[str]:
    """Count near vehicles, those found, detections of vehicles, and those that show one, ignored ones included."""
    assert truth.label is not None
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


def count_matches(weights: Path, worlds: Sequence[WorldName], seeds: Sequence[int], seconds: float) -> Counts:
    """Return the counts of every detector in every world."""
    detectors = {name: CameraDetector(CameraParams(weights / file, SCORE)) for name, file in WEIGHTS.items()}
    counts = {(name, world): Counter[str]() for name in detectors for world in worlds}
    rig = RigSpec(cameras={"camera": thesis_rig().cameras["camera"]})
    for world in worlds:
        for seed in seeds:
            spec = CitySpec(world, condition("clear"), seconds, seed, rig)
            images, truth = images_and_truth(CityRecording(spec, "log"))
            for stamp_ns, image in images.items():
                pixels = decode(image)
                assert pixels is not None
                for name, detector in detectors.items():
                    found = detector.infer(detector.prepare(pixels))
                    counts[name, world] += matches(found, truth[stamp_ns])
    return counts


def main() -> None:
    weights = SHARED / "weights"
    missing = [str(weights / file) for file in WEIGHTS.values() if not (weights / file).is_file()]
    if missing:
        print(f"skipped: no {', '.join(missing)}")
        return
    seeds = SEEDS["dev"][:NUM_SEEDS]
    print(f"clear, seeds {', '.join(map(str, seeds))}, {SECONDS:g} s each; vehicles within {NEAR_M:g} m of which "
          f"{SEEN:.0%} are visible; detections above {SCORE:g}, right above an IoU of {IOU:g}")  # fmt: skip
    print(f"{'detector':14}{'world':10}{'recall':>8}{'found/near':>12}{'precision':>12}{'right/all':>12}")
    for (name, world), c in count_matches(weights, WORLDS, seeds, SECONDS).items():
        recall, precision = c["found"] / max(1, c["near"]), c["right"] / max(1, c["detections"])
        shares = f"{c['found']}/{c['near']}", f"{c['right']}/{c['detections']}"
        print(f"{name:14}{world:10}{recall:8.2f}{shares[0]:>12}{precision:12.2f}{shares[1]:>12}")


if __name__ == "__main__":
    main()
