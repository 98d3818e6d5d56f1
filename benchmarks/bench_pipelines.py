"""The thesis's tables of run times with ours beside them, on a city log of its sensors' sizes and two cores.

    python benchmarks/bench_pipelines.py [--seconds S] [--log LOG] [--stereo-log LOG]

Prints Markdown. Without logs, an urban drive on a clear day is simulated: camera, LiDAR and radar for S seconds, and a
stereo pair for a few. Times are those that the replays themselves write (`timings.parquet`), each stage's first run
left out. The thesis measured on an RTX 4090. It counts preprocessing, synchronization and calibration apart from what
it calls fusion, so here, too, that is detection by all sensors and fusion without them.
"""

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from common import threads, write_drive

from fbench.api.replays import replay
from fbench.metrics.latency import nearest_rank, warm_up_frames
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import describe_host
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

PIPELINES = ("early2d", "early3d", "late2d", "late3d")
SEED, STEREO_S, STEREO = 101, 2.0, ("stereo_left", "stereo_right")
NUM_CORES = 2
TOTAL = "total"
FEW = "0:3"
SENSORS_SEE = ("detect.camera", "detect.lidar", "detect.radar", "detect.stereo")


@dataclass(frozen=True)
class Row:
    """One row of the thesis's table, with a figure [ms] for each of `PIPELINES`."""

    name: str
    stages: tuple[str, ...]  # Ours that are the same
    thesis: tuple[float, ...]
    asked: tuple[float, ...] = ()  # At most so much is wanted

    @property
    def kinds(self) -> dict[str, int]:
        """Its lines: what they are about, and which of the figures."""
        return {name: i for i, name in enumerate(PIPELINES)} if self.stages else {"2D": 0, "3D": 1}


ROWS = (
    Row("preprocessing", ("decode", "preprocess"), (21.37,) * 4),
    Row("synchronization", (), (21.37,) * 4),
    Row("calibration", ("calibrate",), (0.13,) * 4),
    Row("fusion, with detection", (*SENSORS_SEE, "fuse"), (67.11, 96.27, 51.73, 91.40), (33, 48, 26, 45)),
    Row("tracking", ("track",), (0.58, 1.82, 0.58, 1.82), (0.3, 0.9, 0.3, 0.9)),
    Row("visualisation", (), (4.15, 32.51, 4.15, 32.51)),
    Row("whole frame", (TOTAL,), (93.34, 152.1, 77.96, 147.23), (47, 76, 39, 74)),
)
FRAME_NOTES = """
Wanted are halves of the thesis's figures; those of tracking are for 50 objects, see bench_tracking.py.
Waiting for sensors is log time here, and reports draw later; the thesis counts drawing in its whole frames, and waiting
as one with preprocessing. Branches of sensors overlap on two cores, so a stage's figure there is its share of the whole
frame's time; one after another they add up to it.
"""


@dataclass(frozen=True)
class Component:
    """One row of the thesis's table of components."""

    name: str
    pipeline: str  # Whose replay shows it
    stages: tuple[str, ...]
    what: str  # That those do
    before: str
    after: tuple[float, float]  # Its figures [ms] after it moved to the GPU: from, to


COMPONENTS = (
    Component("detector's inference", "camera2d", ("detect.camera",), "inference, decoding of boxes, suppression",
              "23.4; several hundred on CPU", (7.32, 7.32)),
    Component("DBSCAN", "lidar3d", ("detect.lidar",), "clustering, fitting of boxes, judging", "180-210", (13, 25)),
    Component("radar preprocessing", "radar3d", ("calibrate", "preprocess"), "to Cartesian and body, ego motion",
              "203.15", (20.42, 20.42)),
    Component("stereo rectification and disparity", "stereo3d", ("preprocess", "detect.stereo"),
              "rectification, disparity, quality, boxes", "129.38", (16.33, 16.33)),
)  # fmt: skip


def run_pipeline(log: Path, pipeline: str, num_threads: int, folder: Path, frames: str | None = None) -> Run:
    request = ReplayRequest(
        LogRequest(log), pipeline, frames=frames, out=folder / pipeline, overwrite=True, no_media=True
    )
    with threads(num_threads):
        return replay(request).run


def times(run: Run) -> pd.DataFrame:
    """Times [ns], a row for each frame that warmed nothing up, a column for each stage."""
    table = pd.read_parquet(run.folder / "timings.parquet")
    cold = warm_up_frames(run.frame_times, run.compiled_frames)
    return table.pivot_table(index="frame", columns="stage", values="ns", fill_value=0).drop(index=sorted(cold))


def figures(stages: pd.DataFrame, names: Sequence[str]) -> tuple[float, float]:
    """Median and p99 [ms] of the times [ns] of some stages together."""
    together = sorted(round(ns) for ns in stages[[name for name in names if name in stages]].sum(axis=1))
    return nearest_rank(together, 50) / 1e6, nearest_rank(together, 99) / 1e6


def line(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def frame_table(log: Path, folder: Path) -> None:
    """Print the run times of whole frames."""
    both: dict[str, tuple[pd.DataFrame, pd.DataFrame]] = {}
    for pipeline in PIPELINES:
        run_pipeline(log, pipeline, NUM_CORES, folder, FEW)  # compiles, or reads the cache
        run = run_pipeline(log, pipeline, NUM_CORES, folder)
        stages = times(run)
        if not both:
            weights = run.manifest.parameters.get("camera.weights")
            detector = weights["file"] if isinstance(weights, Mapping) else weights
            print(f"\n## Run time a frame\n\nDetector: {detector}. {len(stages)} frames of {log.stem}.\n")
        # Where stages ran side by side, cut their times so that they add up to the whole frame's.
        parts = stages.drop(columns=TOTAL)
        scale = np.minimum(1.0, stages[TOTAL] / parts.sum(axis=1))
        side_by_side = parts.mul(scale, axis=0).assign(**{TOTAL: stages[TOTAL]})
        both[pipeline] = side_by_side, times(run_pipeline(log, pipeline, 1, folder))
    heads = ("stage", "pipeline", "thesis, RTX 4090", "wanted", "ours, two cores", "p99", "p99 / median")
    line(*heads, "one after another")
    line("---", "---", *["---:"] * 6)
    for row in ROWS:
        for kind, i in row.kinds.items():
            ours = ("–",) * 4
            if row.stages:
                (median, p99), (alone, _) = (figures(stages, row.stages) for stages in both[kind])
                ours = f"{median:.2f}", f"{p99:.2f}", f"{p99 / median:.2f}", f"{alone:.2f}"
            line(row.name, kind, f"{row.thesis[i]:.2f}", f"{row.asked[i]:g}" if row.asked else "–", *ours)
    print(FRAME_NOTES, end="")


def component_table(log: Path, stereo_log: Path, folder: Path) -> None:
    """Print the run times of components."""
    print("\n## Components\n")
    line("component", "thesis, before", "after", "half of that", "ours, two cores", "p99", "what ours does")
    line("---", "---:", "---:", "---:", "---:", "---:", "---")
    for part in COMPONENTS:
        where = stereo_log if part.pipeline == "stereo3d" else log
        run_pipeline(where, part.pipeline, NUM_CORES, folder, FEW)
        median, p99 = figures(times(run_pipeline(where, part.pipeline, NUM_CORES, folder)), part.stages)
        after, half = ("-".join(f"{ms / by:.4g}" for ms in dict.fromkeys(part.after)) for by in (1, 2))
        line(part.name, part.before, after, half, f"{median:.2f}", f"{p99:.2f}", f"{part.what} ({part.pipeline})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the drive")
    parser.add_argument("--log", type=Path, help="another with camera, LiDAR and radar")
    parser.add_argument("--stereo-log", type=Path, help="another with a stereo pair")
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:NUM_CORES])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = args.log or write_drive(folder / f"urban-{SEED}.mcap", "urban", args.seconds, SEED)
        pair = args.stereo_log or write_drive(folder / f"stereo-{SEED}.mcap", "urban", STEREO_S, SEED, STEREO)
        host = describe_host()
        print(f"# Run times, ms\n\n{host['cpu']}, {len(os.sched_getaffinity(0))} of its cores.")
        frame_table(log, folder)
        component_table(log, pair, folder)


if __name__ == "__main__":
    main()
