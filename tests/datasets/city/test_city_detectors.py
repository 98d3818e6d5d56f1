"""Detectors that were trained on photographs (COCO) find vehicles in the city; figures: `bench_city_detectors.py`."""

import runpy
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.city.request import SEEDS
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.boxes import Boxes2D

FOLDER = Path(__file__).parents[3] / "benchmarks"
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(FOLDER)  # benchmarks share files
    BENCHMARK = runpy.run_path(str(FOLDER / "bench_city_detectors.py"))


@pytest.mark.slow
def test_detectors_find_some_near_vehicles(shared: Path) -> None:
    """Bars far below what is measured: they fall where vehicles stop looking like vehicles."""
    if not (shared / "weights").is_dir():
        pytest.skip(f"no weights at {shared / 'weights'}")
    counts = BENCHMARK["count_matches"](shared / "weights", ("urban", "highway"), SEEDS["dev"][:1], 1.0)
    for name in BENCHMARK["WEIGHTS"]:
        total = counts[name, "urban"] + counts[name, "highway"]
        assert total["found"] >= 0.3 * total["near"] > 0
        assert total["right"] >= 0.7 * total["detections"] > 0


def test_counts_by_hand() -> None:
    """Near and found; near and missed; hidden, far and no vehicle, which aren't asked for; one detection of nothing."""
    outlines = np.array([(0, 0, 10, 10), (20, 0, 30, 10), (40, 0, 50, 10), (60, 0, 70, 10), (80, 0, 90, 10.0)])
    truth = Boxes2D(
        np.full(5, "camera"), outlines, label=np.array(["car", "truck", "car", "bus", "pedestrian"]),
        visible_xyxy_px=outlines, distance_m=np.array([10.0, 10, 10, 40, 10]),
        visibility=np.array([1.0, 1, 0.4, 1, 1]), ignore=np.zeros(5, bool),
    )  # fmt: skip
    boxes = np.concatenate([outlines[[0, 2, 4]], [(0, 50, 10, 60)]])
    found = CameraDetections(boxes, np.full(4, 0.9), np.array(["car", "car", "pedestrian", "truck"]))
    assert BENCHMARK["matches"](found, truth) == Counter(near=2, found=1, detections=3, right=2)
    nothing = CameraDetections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U3"))
    assert BENCHMARK["matches"](nothing, truth) == Counter(near=2)
