"""Accuracy of the built-in camera detector on drives that it never saw: AP50 by class, distance, visibility, weather.

    python benchmarks/bench_builtin_detector.py [--split dev|test] [--seeds N] [--weights FILE] [--conditions ...]

The tables of docs/detector.md are its output for the test seeds.
"""

import argparse
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import numpy as np
from common import images_and_truth
from rich.console import Console
from rich.progress import track

from fbench.datasets.city.recording import Cities, CityRecording
from fbench.datasets.city.request import SEEDS
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName, condition
from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.coco.profile import CocoProfile
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetections, CameraDetector, CameraParams
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Array, Bool
from fbench.replay.data.boxes import VEHICLES, Boxes2D
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image
from fbench.replay.data.sequences import Objects, Steps
from fbench.replay.data.sequences import Sequence as Drive

FAR_M, SEEN = 50.0, 0.5  # Vehicles count up to this distance, and where at least so much of them is visible
MIN_SCORE = 0.01
SECONDS, RATE_HZ = 20.0, 1.0
WORLDS: tuple[WorldName, ...] = ("urban", "highway")
WEATHERS = ("clear", "traffic", "rain", "heavy-rain", "fog", "dense-fog", "night", "dusk", "low-sun", "overcast")
CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
DISTANCES_M = ((0.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 50.0), (50.0, 80.0))
VISIBILITIES = ((0.1, 0.3), (0.3, 0.5), (0.5, 0.8), (0.8, 1.01))
Wanted: TypeAlias = Callable[[Array, Array], Bool]
"""Which truth boxes count, by distance (N,) [m] and visible share (N,)."""


@dataclass(frozen=True)
class Number:
    """AP50, and of how many boxes."""

    value: float | None
    num_truth: int

    def __str__(self) -> str:
        return f"{'-' if self.value is None else f'{self.value:.3f}'} ({self.num_truth})"


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
        rig = RigSpec(cameras={"camera": camera})
        specs = [CitySpec(self.world, condition(weather), SECONDS, self.seed, rig) for weather in self.weathers]
        names = [f"{self.world}-{weather}-{self.seed}" for weather in self.weathers]
        return [drive(detector, CityRecording(s, n, cities=cities)) for s, n in zip(specs, names, strict=True)]


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
    found = [detect(detector, images[stamp]) for stamp in stamps]
    steps = Steps(np.arange(len(stamps)), np.array(stamps), np.zeros(len(stamps), np.int64))
    return Drive(log.name, steps, truth_objects([truths[stamp] for stamp in stamps]), found_objects(found))


def detect(detector: CameraDetector, image: Image) -> CameraDetections:
    pixels = decode(image)
    assert pixels is not None
    return detector.infer(detector.prepare(pixels))


def truth_objects(boxes: Sequence[Boxes2D]) -> Objects:
    def joined(field: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(part, field)) for part in boxes])

    step = np.repeat(np.arange(len(boxes)), [len(part) for part in boxes])
    none = np.zeros(len(step))
    return Objects(
        step, joined("label"), joined("track_id").astype(np.int64), none, joined("xyxy_px"),
        distance_m=joined("distance_m"), visibility=joined("visibility"), ignore=joined("ignore"),
    )  # fmt: skip


def found_objects(found: Sequence[CameraDetections]) -> Objects:
    step = np.repeat(np.arange(len(found)), [len(part) for part in found])
    label, score, xyxy = (np.concatenate([getattr(part, f) for part in found]) for f in ("label", "score", "xyxy_px"))
    return Objects(step, label, np.full(len(step), -1), score, xyxy)


def usual(distance_m: Array, visibility: Array) -> Bool:
    """Tell what should be found: near, and mostly visible."""
    return (distance_m < FAR_M) & (visibility >= SEEN)


def at_distance(low_m: float, high_m: float) -> Wanted:
    return lambda distance_m, visibility: (visibility >= SEEN) & (distance_m >= low_m) & (distance_m < high_m)


def visible(low: float, high: float) -> Wanted:
    return lambda distance_m, visibility: (distance_m < FAR_M) & (visibility >= low) & (visibility < high)


def ap50(found: Sequence[Drive], wanted: Wanted = usual, labels: Sequence[str] = VEHICLES) -> Number:
    """Return AP50 of some labels as one class; other truth of these labels excuses what lies in it."""
    profile = CocoProfile(classes=("object",)).with_match(Match("iou2d", 0.5))
    row = evaluate(profile, [_as_one_class(one, wanted, labels) for one in found]).scores()[0]
    return Number(row.value, int(row.counts["truth"]))


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
        worlds = " | ".join(str(ap50(part)) for part in parts)
        print(f"| {weather} | {ap50(found)} | {worlds} | {f1:.3f} at {score:.2f} |")
    if "clear" in of_weather:
        details(of_weather["clear"])


def details(clear: Sequence[Drive]) -> None:
    """Print how AP50 depends on class, distance and visibility in clear weather."""
    print("\n| class, clear | AP50 |\n|---|---|")
    for label in CLASSES:
        print(f"| {label} | {ap50(clear, labels=(label,))} |")
    print("\n| distance, clear | AP50 |\n|---|---|")
    for low, high in DISTANCES_M:
        print(f"| {low:g} to {high:g} m | {ap50(clear, at_distance(low, high))} |")
    print("\n| visible share, clear | AP50 |\n|---|---|")
    for low, high in VISIBILITIES:
        print(f"| {low:.0%} to {min(high, 1):.0%} | {ap50(clear, visible(low, high))} |")


if __name__ == "__main__":
    main()
