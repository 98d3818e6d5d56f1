"""Weather that the city renders beside the same weather injected into its clear logs: what sensors get, F1, and ranks.

    python benchmarks/bench_rendered_weather.py FOLDER [--seeds 101,102] [--seconds 2] [--severities 1,3,5]
    python benchmarks/bench_rendered_weather.py FOLDER --weights FILE.onnx
    python benchmarks/bench_rendered_weather.py FOLDER --stereo
    python benchmarks/bench_rendered_weather.py FOLDER --no-lamps [--weights FILE.onnx]
    python benchmarks/bench_rendered_weather.py FOLDER --causes

FOLDER keeps logs and runs, so that the same command continues. Both logs of a pair show one scene in one state of the
air and the light: that which `fog:3` names. Prints tables in Markdown. With `--weights`, camera2d with that detector is
scored alone; with `--stereo`, stereo3d on logs of the stereo pair and the LiDAR; with `--no-lamps`, camera2d in nights
in which nothing shines but the sky; with `--causes`, injected images are changed step by step until they are like the
rendered ones.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from common import write_missing
from scipy.stats import kendalltau, spearmanr

from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.datasets.city.camera import picture
from fbench.datasets.city.camera.sky import light_of
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import CityRequest
from fbench.datasets.city.rig import thesis_rig
from fbench.datasets.city.sensors.lidar import power_floor
from fbench.datasets.city.spec import Condition
from fbench.metrics.robustness.scenes import ScoredRun, pool, spaces_of
from fbench.replay.conditions.camera.depth import distances, gray_cells
from fbench.replay.conditions.camera.fog import attenuate
from fbench.replay.conditions.camera.precipitation import add_rain
from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.lidar.weather import receive
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.conditions.weather import CLEAR_MOR_M, Weather, extinction_per_m, rain_extinction_per_m
from fbench.replay.contracts.conditions import MakesWeather, Site
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest, log_source

PIPELINES = ("camera2d", "lidar2d", "radar2d", "lidar3d", "radar3d", "early2d", "early3d", "late2d", "late3d")
WEATHERS = ("fog", "rain", "night")
RENDERED, INJECTED = "rendered", "injected"
CITY_AIRLIGHT = 0.92  # Of fog by day, as the city stores it
_LEAST_PX = 20  # Height of the boxes whose contrast is measured


@dataclass(frozen=True)
class Case:
    """One weather on one scene, rendered or injected."""

    weather: str
    severity: int
    seed: int
    way: str

    @property
    def name(self) -> str:
        """As conditions are written; `clear` at severity 0."""
        return f"{self.weather}:{self.severity}" if self.severity else "clear"


def weather_of(name: str) -> Weather:
    """Return the weather that a condition is."""
    (part,) = parse_conditions(name)
    assert isinstance(part.condition, MakesWeather)
    return part.condition.weather(part.level)


def write_log(folder: Path, case: Case, seconds: float, sensors: Sequence[str]) -> Path:
    """Render a case, unless its log is there."""
    spec = CityRequest("urban", "clear", seconds, case.seed, sensors=sensors).spec()
    if case.severity:
        spec = replace(spec, condition=Condition(case.name, weather_of(case.name)))
    out = folder / f"{case.name.replace(':', '-')}-{case.seed}.mcap"
    return write_missing(CityRecording(spec, out.stem), out)


def score_all(
    folder: Path, cases: Mapping[Case, Path], pipelines: Sequence[str], settings: Sequence[str]
) -> dict[tuple[Case, str], Run]:
    """Replay every case into every pipeline, unless the run is there."""
    requests = {
        (case, pipeline): ReplayRequest(
            LogRequest(log), pipeline, settings, condition=case.name if case.way == INJECTED and case.severity else "",
            out=folder / f"{case.way}-{log.stem}-{case.name.replace(':', '-')}-{pipeline}", no_media=True,
        )
        for (case, log), pipeline in product(cases.items(), pipelines)
    }  # fmt: skip
    results = run_suite(list(requests.values()), RunOptions())
    assert all(result.has_run for result in results), [result.reason for result in results if not result.has_run]
    return {key: Run(result.folder) for key, result in zip(requests, results, strict=True)}


def sense(case: Case, log: Path) -> dict[str, float]:
    """Return means over what the sensors of a case give: of the image gray and the contrast within vehicles, of clouds
    points in all and how far they are, of radars echoes.
    """
    source = log_source(LogRequest(log))
    text = case.name if case.way == INJECTED and case.severity else ""
    reader = DisturbedReader(source.open(FaultLog()), Disturbance(parse_conditions(text), 0, source.span()), Effects())
    boxes = {t.stamp_ns: t.boxes2d for t in reader.truths() if t.boxes2d is not None}
    found: dict[str, list[float]] = {}
    for message in reader.messages():
        for name, value in _measure(message, boxes.get(message.stamp_ns) if isinstance(message, Image) else None):
            found.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in found.items()}


def _measure(message: object, boxes: Boxes2D | None) -> Iterator[tuple[str, float]]:
    match message:
        case Image():
            pixels = decode(message)
            assert pixels is not None
            gray = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
            yield "gray", float(gray.mean())
            for x0, y0, x1, y1 in () if boxes is None else np.round(boxes.xyxy_px).astype(int):
                own = gray[max(y0, 0) : y1, max(x0, 0) : x1]
                if y1 - y0 >= _LEAST_PX and own.size:
                    yield "contrast", float(own.std())
        case PointCloud():
            yield "points", len(message.xyz)
            yield "range_m", float(np.linalg.norm(message.xyz, axis=1).mean()) if len(message.xyz) else 0.0
        case RadarScan():
            yield "echoes", len(message.xyz)
        case _:
            pass


def mix(pixels: Pixels, t: Float32, airlight: float, *, is_linear: bool) -> Pixels:
    """Return I t + L (1 - t), on values as they are stored or on light."""
    image, far = pixels / 255, np.array(airlight)
    if not is_linear:
        return np.asarray(255 * (image * t + far * (1 - t)) + 0.5, np.uint8)
    return store(to_light(image) * t + to_light(far) * (1 - t))


def to_light(value: Array) -> Float64:
    """Return the light of stored values from 0 to 1 (IEC 61966-2-1)."""
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4), np.float64)


def store(light: Float64) -> Pixels:
    """Return the pixels of light."""
    value = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(255 * np.clip(value, 0, 1) + 0.5, np.uint8)


def change_injected(weather: Weather, image: Image, site: Site) -> Iterator[tuple[str, Pixels]]:
    """Yield a clear image in a weather: as injected, then changed step by step towards what the city renders."""
    pixels, injected = decode(image), decode(disturb_image(image, weather, site))
    assert pixels is not None
    assert injected is not None
    yield INJECTED, injected
    if weather.visibility_m < CLEAR_MOR_M:
        far = cv2.resize(distances(gray_cells(pixels), image.size_wh, site), image.size_wh)[..., None]
        t = np.asarray(np.exp(-extinction_per_m(weather) * far), np.float32)
        yield f"airlight {CITY_AIRLIGHT}", mix(pixels, t, CITY_AIRLIGHT, is_linear=False)
        yield "and on light", mix(pixels, t, CITY_AIRLIGHT, is_linear=True)
    elif weather.rain_mm_h > 0:
        thin = attenuate(pixels, rain_extinction_per_m(weather.rain_mm_h), site)
        yield "not duller", add_rain(thin, weather.rain_mm_h, site.rng_of(image, "rain"))
        yield "nor streaks", thin


def images_of(log: Path) -> Iterator[tuple[Image, Site, Boxes2D | None]]:
    """Yield every fourth image of a log, raw, with what conditions and truth say of it."""
    reader = log_source(LogRequest(log)).open(FaultLog())
    boxes = {truth.stamp_ns: truth.boxes2d for truth in reader.truths()}
    site, num = Site((0, "causes@1:3", reader.info.log_id, "camera"), reader.rig, "camera", "camera", 0, 0), 0
    for message in reader.messages():
        if isinstance(message, PointCloud):
            site = replace(site, cloud=message)
        elif isinstance(message, Image) and (pixels := decode(message)) is not None:
            num += 1
            if num % 4 == 1:
                yield replace(message, data=pixels.tobytes(), encoding="bgr8"), site, boxes.get(message.stamp_ns)


def print_causes(cases: Mapping[Case, Path], names: Sequence[str]) -> None:
    """Print gray and contrast of images that are injected, changed and rendered, and how many echoes the model of drops
    gives beams without a target.
    """
    lidar = thesis_rig().lidars["lidar"]
    clear = {case.seed: log for case, log in cases.items() if not case.severity}
    for case, log in ((case, log) for case, log in cases.items() if case.way == RENDERED and case.name in names):
        weather, found = weather_of(case.name), dict[str, dict[str, list[float]]]()

        def add(way: str, image: Image, pixels: Pixels, boxes: Boxes2D | None) -> None:
            for name, value in _measure(replace(image, data=pixels.tobytes()), boxes):
                found.setdefault(way, {}).setdefault(name, []).append(value)  # noqa: B023  # called within the loop

        num_points = 0
        for image, site, boxes in images_of(clear[case.seed]):
            num_points = num_points or (0 if site.cloud is None else len(site.cloud.xyz))
            for way, pixels in change_injected(weather, image, site):
                add(way, image, pixels, boxes)
        longer = light_of(weather).exposure / light_of(Weather()).exposure
        for image, _, boxes in images_of(log):
            own = np.frombuffer(image.data, np.uint8).reshape(*image.size_wh[::-1], 3)
            add(RENDERED, image, own, boxes)
            add(f"at 1 / {longer:.4g} of its exposure", image, store(to_light(own / 255) / longer), boxes)
        print(f"{case.name}, seed {case.seed}")
        for way, values in found.items():
            print(f"  {way}: " + ", ".join(f"{name} {np.mean(column):.1f}" for name, column in values.items()))
        if weather.rain_mm_h > 0:
            num = round(lidar.points_per_s / lidar.rate_hz) - num_points
            nothing, floor = np.zeros(num), power_floor(lidar.range_m)
            at_m, _, _ = receive(nothing + np.inf, nothing, weather, floor, generator(case.seed, "causes"))
            print(f"  {np.count_nonzero(np.isfinite(at_m))} echoes on {num} beams without a target")


def f1(runs: Mapping[tuple[Case, str], Run], pipeline: str, way: str, name: str) -> float:
    """F1 of a pipeline over all scenes, in its own space."""
    scored = [
        ScoredRun(pipeline, case.name, str(case.seed), run.scores)
        for (case, which), run in runs.items() if (which, case.way, case.name) == (pipeline, way, name)
    ]  # fmt: skip
    value = pool(scored, "f1", spaces_of(scored)[-1]).value
    return 0.0 if value is None else value


def print_agreement(title: str, pairs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> None:
    """Print Kendall's tau-b and Spearman's rho, both for ties, of rendered against injected values: mean over rows. A
    row of equal values has no ranks, and is left out.
    """
    ranked = [(a, b) for a, b in pairs if len(set(a)) > 1 and len(set(b)) > 1]
    taus, rhos = ([float(of(a, b).statistic) for a, b in ranked] for of in (kendalltau, spearmanr))
    if ranked:
        print(f"| {title} | {len(ranked)} of {len(pairs)} | {np.mean(taus):+.2f} | {np.mean(rhos):+.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", default="101,102")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--severities", default="1,3,5")
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--stereo", action="store_true")
    parser.add_argument("--no-lamps", action="store_true")
    parser.add_argument("--causes", action="store_true")
    args = parser.parse_args()
    folder: Path = args.folder
    sensors: Sequence[str] = ("camera", "lidar", "radar")
    pipelines: Sequence[str] = PIPELINES
    weathers: Sequence[str] = WEATHERS
    if args.stereo:
        folder, sensors, pipelines = folder / "stereo", ("stereo_*", "lidar"), ("stereo3d",)
    if args.no_lamps:
        folder, sensors, pipelines, weathers = folder / "no-lamps", ("camera",), ("camera2d",), ("night",)
        vars(picture)["light_of"] = lambda weather: light_of(weather)._replace(is_dark=False, is_dim=False)
    seeds, severities = ([int(word) for word in text.split(",")] for text in (args.seeds, args.severities))
    folder.mkdir(parents=True, exist_ok=True)
    cases: dict[Case, Path] = {}
    for seed in seeds:
        clear = Case("clear", 0, seed, RENDERED)
        cases[clear] = write_log(folder, clear, args.seconds, sensors)
        for weather, severity in product(weathers, severities):
            rendered = Case(weather, severity, seed, RENDERED)
            cases[rendered] = write_log(folder, rendered, args.seconds, sensors)
            cases[replace(rendered, way=INJECTED)] = cases[clear]
    names = [f"{weather}:{severity}" for weather, severity in product(weathers, severities)]
    if args.causes:
        print_causes(cases, names)
    elif args.weights:
        settings = [f"camera.weights={args.weights}"]
        print_scores(score_all(folder / "weights", cases, ("camera2d",), settings), names)
    else:
        print_sensed(cases, names)
        print_scores(score_all(folder / "runs", cases, pipelines, ()), names)


def print_sensed(cases: Mapping[Case, Path], names: Sequence[str]) -> None:
    """Print what sensors get, rendered / injected."""
    sensed = [(case, sense(case, log)) for case, log in cases.items()]
    columns = list(sensed[0][1])
    print("\n| weather | " + " | ".join(columns) + " |\n|---|" + "---:|" * len(columns))
    for name in ("clear", *names):
        cells = []
        for column in columns:
            of = {way: [s[column] for c, s in sensed if (c.name, c.way) == (name, way)] for way in (RENDERED, INJECTED)}
            cells.append(" / ".join(f"{np.mean(values):.4g}" for values in of.values() if values))
        print(f"| `{name}` | " + " | ".join(cells) + " |")


def print_scores(runs: Mapping[tuple[Case, str], Run], names: Sequence[str]) -> None:
    """Print F1 in %, rendered / injected, and how far ranks agree."""
    pipelines = list(dict.fromkeys(pipeline for _, pipeline in runs))
    table = {(p, way, name): f1(runs, p, way, name) for p, way, name in product(pipelines, (RENDERED, INJECTED), names)}
    print("\n| weather | " + " | ".join(f"`{p}`" for p in pipelines) + " |\n|---|" + "---:|" * len(pipelines))
    print("| clear | " + " | ".join(f"{100 * f1(runs, p, RENDERED, 'clear'):.1f}" for p in pipelines) + " |")
    for name in names:
        both = [[100 * table[p, way, name] for way in (RENDERED, INJECTED)] for p in pipelines]
        print(f"| `{name}` | " + " | ".join(f"{a:.1f} / {b:.1f}" for a, b in both) + " |")
    print("\n| ranks of | rows | Kendall | Spearman |\n|---|---:|---:|---:|")
    by_name = [tuple([table[p, way, name] for p in pipelines] for way in (RENDERED, INJECTED)) for name in names]
    print_agreement("pipelines, in each weather", [(a, b) for a, b in by_name])
    by_weather = [
        [[table[p, way, name] for name in names if name.startswith(weather)] for way in (RENDERED, INJECTED)]
        for p, weather in product(pipelines, WEATHERS)
    ]  # fmt: skip
    print_agreement("severities, of each pipeline and weather", [(a, b) for a, b in by_weather])
    whole = [[[table[p, way, name] for name in names] for way in (RENDERED, INJECTED)] for p in pipelines]
    print_agreement("all weathers, of each pipeline", [(a, b) for a, b in whole])


if __name__ == "__main__":
    main()
