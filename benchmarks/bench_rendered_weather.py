"""Weather that the city renders beside the same weather injected into its clear logs: what sensors get, F1, and ranks.

    python benchmarks/bench_rendered_weather.py FOLDER [--seeds 101,102] [--seconds 2] [--severities 1,3,5]

FOLDER keeps logs and runs, so that the same command continues. Both logs of a pair show one scene in one state of the
air and the light: that which `fog:3` names. Prints tables in Markdown.
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

from fbench.api.suite import run_suite
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import Scene, experiment_spec
from fbench.datasets.city.spec import Condition
from fbench.metrics.robustness.scenes import ScoredRun, pool, spaces_of
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.conditions import MakesWeather
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest, log_source

PIPELINES = ("camera2d", "lidar2d", "radar2d", "lidar3d", "radar3d", "early2d", "early3d", "late2d", "late3d")
WEATHERS = ("fog", "rain", "night")
RENDERED, INJECTED = "rendered", "injected"
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


def write_log(folder: Path, case: Case, seconds: float) -> Path:
    """Render a case, unless its log is there."""
    spec = experiment_spec(Scene("urban", "clear"), case.seed, seconds)
    if case.severity:
        (part,) = parse_conditions(case.name)
        assert isinstance(part.condition, MakesWeather)
        spec = replace(spec, condition=Condition(case.name, part.condition.weather(part.level)))
    out = folder / f"{case.name.replace(':', '-')}-{case.seed}.mcap"
    return write_missing(CityRecording(spec, out.stem), out)


def score_all(folder: Path, cases: Mapping[Case, Path]) -> dict[tuple[Case, str], Run]:
    """Replay every case into every pipeline, unless the run is there."""
    requests = {
        (case, pipeline): ReplayRequest(
            LogRequest(log), pipeline, condition=case.name if case.way == INJECTED and case.severity else "",
            out=folder / "runs" / f"{case.way}-{log.stem}-{case.name.replace(':', '-')}-{pipeline}", no_media=True,
        )
        for (case, log), pipeline in product(cases.items(), PIPELINES)
    }  # fmt: skip
    results = run_suite(list(requests.values()), 1)
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
    args = parser.parse_args()
    seeds, severities = ([int(word) for word in text.split(",")] for text in (args.seeds, args.severities))
    args.folder.mkdir(parents=True, exist_ok=True)
    cases: dict[Case, Path] = {}
    for seed in seeds:
        clear = Case("clear", 0, seed, RENDERED)
        cases[clear] = write_log(args.folder, clear, args.seconds)
        for weather, severity in product(WEATHERS, severities):
            rendered = Case(weather, severity, seed, RENDERED)
            cases[rendered] = write_log(args.folder, rendered, args.seconds)
            cases[replace(rendered, way=INJECTED)] = cases[clear]
    names = [f"{weather}:{severity}" for weather, severity in product(WEATHERS, severities)]
    print_sensed(cases, names)
    print_scores(score_all(args.folder, cases), names)


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
    table = {(p, way, name): f1(runs, p, way, name) for p, way, name in product(PIPELINES, (RENDERED, INJECTED), names)}
    print("\n| weather | " + " | ".join(f"`{p}`" for p in PIPELINES) + " |\n|---|" + "---:|" * len(PIPELINES))
    print("| clear | " + " | ".join(f"{100 * f1(runs, p, RENDERED, 'clear'):.1f}" for p in PIPELINES) + " |")
    for name in names:
        both = [[100 * table[p, way, name] for way in (RENDERED, INJECTED)] for p in PIPELINES]
        print(f"| `{name}` | " + " | ".join(f"{a:.1f} / {b:.1f}" for a, b in both) + " |")
    print("\n| ranks of | rows | Kendall | Spearman |\n|---|---:|---:|---:|")
    by_name = [tuple([table[p, way, name] for p in PIPELINES] for way in (RENDERED, INJECTED)) for name in names]
    print_agreement("pipelines, in each weather", [(a, b) for a, b in by_name])
    by_weather = [
        [[table[p, way, name] for name in names if name.startswith(weather)] for way in (RENDERED, INJECTED)]
        for p, weather in product(PIPELINES, WEATHERS)
    ]  # fmt: skip
    print_agreement("severities, of each pipeline and weather", [(a, b) for a, b in by_weather])
    whole = [[[table[p, way, name] for name in names] for way in (RENDERED, INJECTED)] for p in PIPELINES]
    print_agreement("all weathers, of each pipeline", [(a, b) for a, b in whole])


if __name__ == "__main__":
    main()
