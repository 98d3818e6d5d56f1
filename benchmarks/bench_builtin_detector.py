"""Accuracy of the built-in camera detector on drives that it never saw: AP50 by class, distance, visibility, weather.

    python benchmarks/bench_builtin_detector.py [--split dev|test] [--seeds N] [--weights FILE] [--conditions ...]

The tables of docs/detector.md are its output for the test seeds.
"""

import argparse
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import numpy as np
from common import images_and_truth
from rich.console import Console
from rich.progress import track
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from fbench.datasets.city.recording import Cities, CityRecording
from fbench.datasets.city.request import SEEDS
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName, condition
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.coco.profile import CocoProfile
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetector, CameraParams
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Array, Bool
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.images import decode
from fbench.replay.data.sequences import Objects, Steps
from fbench.replay.data.sequences import Sequence as Drive
from fbench.replay.geometry.iou import iou_2d

FAR_M, SEEN = 50.0, 0.5  # Vehicles count up to this distance, and where at least so much of them is visible
MIN_SCORE = 0.01
SURE = (0.6, 0.4)  # Scores from which on recall is given
SECONDS, RATE_HZ = 20.0, 1.0
WORLDS: tuple[WorldName, ...] = ("urban", "highway")
WEATHERS = ("clear", "traffic", "rain", "heavy-rain", "fog", "dense-fog", "night", "dusk", "low-sun", "overcast")
CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
DISTANCES_M = ((0.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 50.0), (50.0, 80.0))
VISIBILITIES = ((0.1, 0.3), (0.3, 0.5), (0.5, 0.8), (0.8, 1.01))
Wanted: TypeAlias = Callable[[Array, Array], Bool]
"""Which truth boxes count, by distance (N,) [m] and visible share (N,)."""


@dataclass(frozen=True)
class City:
    """One city's drives, all weathers, since it takes seconds to build."""

    params: CameraParams
    world: WorldName
    seed: int
    weathers: tuple[str, ...]

    def drives(self) -> list[Drive]:
        detector, cities = CameraDetector(self.params), Cities()
        camera = thesis_rig().cameras["camera"].model_copy(update={"rate_hz": RATE_HZ})
        rig, result = RigSpec(cameras={"camera": camera}), []
        for weather in self.weathers:
            spec = CitySpec(self.world, condition(weather), SECONDS, self.seed, rig)
            log = CityRecording(spec, f"{self.world}-{weather}-{self.seed}", cities=cities)
            result.append(drive(detector, log))
        return result


def drives(params: CameraParams, weathers: Sequence[str], seeds: Sequence[int]) -> dict[str, list[Drive]]:
    """Return by weather what is true and what is found along drives in both worlds."""
    cities = [City(params, world, seed, tuple(weathers)) for world, seed in product(WORLDS, seeds)]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        found = list(track(pool.map(City.drives, cities), "cities", len(cities), console=Console(stderr=True)))
    return {weather: list(of_weather) for weather, of_weather in zip(weathers, zip(*found, strict=True), strict=True)}


def drive(detector: CameraDetector, log: CityRecording) -> Drive:
    """Detect in all images of a log."""
    images, truths = images_and_truth(log)
    stamps = sorted(set(images) & set(truths))
    pixels = (decode(images[stamp]) for stamp in stamps)
    found = [detector.infer(detector.prepare(image)) for image in pixels if image is not None]
    assert len(found) == len(stamps)

    def join(parts: Sequence[object], field: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(part, field)) for part in parts])

    boxes = [truths[stamp] for stamp in stamps]
    step = np.repeat(np.arange(len(boxes)), [len(part) for part in boxes])
    truth = Objects(
        step, join(boxes, "label"), join(boxes, "track_id").astype(np.int64), np.zeros(len(step)),
        join(boxes, "xyxy_px"), distance_m=join(boxes, "distance_m"), visibility=join(boxes, "visibility"),
        ignore=join(boxes, "ignore"),
    )  # fmt: skip
    step = np.repeat(np.arange(len(found)), [len(part) for part in found])
    estimates = Objects(
        step, join(found, "label"), np.full(len(step), -1), join(found, "score"), join(found, "xyxy_px")
    )
    steps = Steps(np.arange(len(stamps)), np.array(stamps), np.zeros(len(stamps), np.int64))
    return Drive(log.name, steps, truth, estimates)


def usual(distance_m: Array, visibility: Array) -> Bool:
    """Tell what should be found: near, and mostly visible."""
    return (distance_m < FAR_M) & (visibility >= SEEN)


def at_distance(low_m: float, high_m: float, distance_m: Array, visibility: Array) -> Bool:
    return (visibility >= SEEN) & (distance_m >= low_m) & (distance_m < high_m)


def visible(low: float, high: float, distance_m: Array, visibility: Array) -> Bool:
    return (distance_m < FAR_M) & (visibility >= low) & (visibility < high)


def ap50(found: Sequence[Drive], wanted: Wanted = usual, labels: Sequence[str] = VEHICLES) -> str:
    """AP50 of some labels as one class, and of how many boxes; other truth of these labels excuses what lies in it."""
    profile = CocoProfile(classes=("object",)).with_match(Match("iou2d", 0.5))
    row = evaluate(profile, [_as_one_class(one, wanted, labels) for one in found]).scores()[0]
    return f"{'-' if row.value is None else f'{row.value:.3f}'} ({int(row.counts['truth'])})"


def _as_one_class(one: Drive, wanted: Wanted, labels: Sequence[str]) -> Drive:
    truth = one.truth[np.isin(one.truth.label, labels)]
    estimates = one.estimates[np.isin(one.estimates.label, labels)]
    name = np.array("object")
    assert truth.distance_m is not None
    assert truth.visibility is not None
    assert truth.ignore is not None
    ignore = truth.ignore | ~wanted(truth.distance_m, truth.visibility)
    truth = replace(truth, label=np.full(len(truth), name), ignore=ignore)
    return replace(one, truth=truth, estimates=replace(estimates, label=np.full(len(estimates), name)))


def recall(found: Sequence[Drive], label: str, least: float, far_m: float = 30.0) -> str:
    """Share of a label's boxes, nearer than `far_m` and mostly visible, that a box of the label with such a score
    overlaps by half; with any label, too. One box finds one object.
    """
    hits, any_label, num = 0, 0, 0
    for one in found:
        assert one.truth.distance_m is not None
        assert one.truth.visibility is not None
        assert one.truth.ignore is not None
        near = (one.truth.distance_m < far_m) & (one.truth.visibility >= SEEN) & ~one.truth.ignore
        truth, sure = one.truth[near & (one.truth.label == label)], one.estimates[one.estimates.score >= least]
        num += len(truth)
        assert truth.xyxy_px is not None
        assert sure.xyxy_px is not None
        for step in np.unique(truth.step).tolist():
            boxes, at = truth.xyxy_px[truth.step == step], sure.step == step
            overlap = iou_2d(boxes, sure.xyxy_px[at]) >= 0.5
            any_label += _num_pairs(overlap)
            hits += _num_pairs(overlap & (sure.label[at] == label))
    return "- (0)" if num == 0 else f"{hits / num:.2f}, {any_label / num:.2f} ({num})"


def _num_pairs(overlap: Bool) -> int:
    """Most pairs (T, E) of which no two share a row or column."""
    return int((maximum_bipartite_matching(csr_matrix(overlap)) >= 0).sum()) if overlap.size else 0


def best_f1(found: Sequence[Drive]) -> tuple[float, float]:
    """Return the highest F1 of vehicles, and the score from which on detections count for it."""
    profile = CocoProfile(classes=("object",)).with_match(Match("iou2d", 0.5))
    total = evaluate(profile, [_as_one_class(one, usual, VEHICLES) for one in found]).total.classes["object"]
    scores = np.sort(np.concatenate([part.score for part in total.parts]))[::-1]
    outcome = total.rank()[1][0, 0]
    f1 = 2 * np.cumsum(outcome == 1) / (np.cumsum(outcome < 2) + total.num_truth[0])
    best = int(np.argmax(f1))
    return float(f1[best]), float(scores[best])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--split", choices=("dev", "test"), default="test")
    parser.add_argument("--seeds", type=int, nargs="*", help="instead of those of the split")
    parser.add_argument("--weights", type=Path, default=CITY_WEIGHTS)
    parser.add_argument("--conditions", nargs="*", default=WEATHERS)
    asked = parser.parse_args()
    seeds = asked.seeds or SEEDS[asked.split]
    print(f"AP50 of {asked.weights.name}, seeds {', '.join(map(str, seeds))}, urban and highway, {SECONDS:g} s each "
          f"with {RATE_HZ:g} images a second; vehicles (as one class) nearer than {FAR_M:g} m of which at least "
          f"{SEEN:.0%} are visible, unless said otherwise; in brackets how many")  # fmt: skip
    print("\n| condition | both | urban | highway | best F1 |\n|---|---|---|---|---|")
    of_weather = drives(CameraParams(asked.weights, MIN_SCORE), list(dict.fromkeys(asked.conditions)), seeds)
    for weather, found in of_weather.items():
        parts = [[one for one in found if one.name.startswith(world)] for world in WORLDS]
        f1, score = best_f1(found)
        worlds = " | ".join(map(ap50, parts))
        print(f"| {weather} | {ap50(found)} | {worlds} | {f1:.3f} at {score:.2f} |")
    clear = of_weather.get("clear", ())
    if not clear:
        return
    names = " | ".join(f"recall within 30 m from {least} on, by any label (of how many)" for least in SURE)
    print(f"\n| class, clear | AP50 | {names} |\n|---|---|---|---|")
    for label in CLASSES:
        shares = " | ".join(recall(clear, label, least) for least in SURE)
        print(f"| {label} | {ap50(clear, labels=(label,))} | {shares} |")
    print("\n| distance, clear | AP50 |\n|---|---|")
    for low, high in DISTANCES_M:
        number = ap50(clear, partial(at_distance, low, high))
        print(f"| {low:g} to {high:g} m | {number} |")
    print("\n| visible share, clear | AP50 |\n|---|---|")
    for low, high in VISIBILITIES:
        number = ap50(clear, partial(visible, low, high))
        print(f"| {low:.0%} to {min(high, 1):.0%} | {number} |")


if __name__ == "__main__":
    main()
