"""The thesis's tables of run times with ours beside them, on a city log of its sensors' sizes and two cores.

    python benchmarks/bench_pipelines.py [--seconds S] [--log LOG] [--stereo-log LOG] [--only TABLE]

Prints Markdown. Without logs, an urban drive on a clear day is simulated: camera, LiDAR and radar for S seconds, and a
stereo pair for a few. Times are those that the replays themselves write (`timings.parquet`), each stage's first run
left out. The thesis measured on an RTX 4090. It counts preprocessing, synchronization and calibration apart from what
it calls fusion, so here, too, that is detection by all sensors and fusion without them. Drawing is no stage of a
replay: it is timed apart, on a frame's picture or points with the boxes that were found. The last table has our own
before and after: each component against a plain reference, in one process. `bench_cuda.py` compares with CUDA.
"""

import argparse
import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from common import best_by_turns_s, threads, write_drive
from sklearn.cluster import DBSCAN

from fbench.api.logs import open_log
from fbench.api.replays import replay
from fbench.metrics.latency import nearest_rank, warm_up_frames
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetector, CameraParams
from fbench.pipelines.sensors.lidar.clusters import LidarParams, obstacles
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import StereoParams, StereoStage
from fbench.pipelines.variants.radar import Radar3DParams
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import Pixels, decode, decode_grey
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.stereo_pairs import pairs, rectify
from fbench.replay.geometry.transforms import transform
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import describe_host
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest
from fbench.reports.preview import draw
from fbench.reports.preview.sample import Sample
from fbench.reports.preview.views import from_above, ground_of

PIPELINES = ("early2d", "early3d", "late2d", "late3d")
SEED, STEREO_S, STEREO = 101, 2.0, ("stereo_left", "stereo_right")
NUM_CORES = 2
TOTAL, VISUAL = "total", "visualization"
NUM_DRAWN, NUM_COMPARED, ROUNDS = 20, 4, 3
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
    Row(VISUAL, (), (4.15, 32.51, 4.15, 32.51)),
    Row("whole frame", (TOTAL,), (93.34, 152.1, 77.96, 147.23), (47, 76, 39, 74)),
)
FRAME_NOTES = """
Wanted are halves of the thesis's figures; those of tracking are for 50 objects, see bench_tracking.py.
Waiting for sensors is log time here, and reports draw later, so that visualization is measured apart from replays; the
thesis counts drawing in its whole frames, and waiting as one with preprocessing. Branches of sensors overlap on two
cores, so a stage's figure there is its share of the whole frame's time; one after another they add up to it.
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
    drawn = {kind: drawing_ms(log, Run(folder / pipeline)) for kind, pipeline in (("2D", "late2d"), ("3D", "late3d"))}
    heads = ("stage", "pipeline", "thesis, RTX 4090", "wanted", "ours, two cores", "p99", "p99 / median")
    line(*heads, "one after another")
    line("---", "---", *["---:"] * 6)
    for row in ROWS:
        for kind, i in row.kinds.items():
            ours = ("–",) * 4
            if row.stages:
                (median, p99), (alone, _) = (figures(stages, row.stages) for stages in both[kind])
                ours = f"{median:.2f}", f"{p99:.2f}", f"{p99 / median:.2f}", f"{alone:.2f}"
            elif row.name == VISUAL:
                ours = f"{drawn[kind]:.2f}", "–", "–", "–"
            line(row.name, kind, f"{row.thesis[i]:.2f}", f"{row.asked[i]:g}" if row.asked else "–", *ours)
    print(FRAME_NOTES, end="")


def first_frames(log: Path, num: int) -> tuple[Rig, list[Frame]]:
    opened = open_log(log)
    return opened.rig, list(islice(opened.frames(), num))


def drawing_ms(log: Path, run: Run) -> float:
    """Median time [ms] of drawing what a run found in a frame: 2D boxes with text into the decoded image; 3D boxes and
    the points of all sensors from above.
    """
    rig, frames = first_frames(log, NUM_DRAWN)
    samples = [Sample(frame, rig, found_as_truth(frame, run.detections.at(frame.index))) for frame in frames]
    ground, lidars = ground_of(samples), rig.sensors("lidar")
    taken = []
    for sample in samples:
        boxes = run.detections.at(sample.frame.index)
        if isinstance(boxes, Boxes2D):
            work: Callable[[], object] = partial(draw_in_image, sample.image("camera"), boxes)
        else:
            assert sample.points  # moved into body coordinates beforehand: calibration is another stage
            work = partial(from_above, sample, ground, lidars)
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return 1e3 * float(np.median(taken))


def found_as_truth(frame: Frame, boxes: Boxes) -> Truth:
    """Views draw truth, so what was found takes its place."""
    return Truth(frame.stamp_ns, frame.stamp_ns, boxes3d=boxes if isinstance(boxes, Boxes3D) else None)


def draw_in_image(pixels: Pixels, boxes: Boxes2D) -> Pixels:
    picture = pixels.copy()
    for i, box in enumerate(boxes.xyxy_px):
        draw.path(picture, box[draw.OUTLINE].reshape(5, 2), draw.TRUTH, 2)
        far = "" if boxes.distance_m is None else f" {boxes.distance_m[i]:.1f} m"
        draw.write(picture, f"{'' if boxes.label is None else boxes.label[i]}{far}", (box[0], box[1] - 4), boxed=True)
    return picture


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


def plain_echoes(scan: RadarScan, body_T_radar: Float64) -> Float64:
    """Polar to Cartesian and to the body echo by echo, as a first version would do it (thesis, Preprocessing)."""
    found = []
    polar = zip(scan.range_m.tolist(), scan.azimuth_rad.tolist(), scan.altitude_rad.tolist(), strict=True)  # type: ignore[union-attr]
    for r, theta, phi in polar:
        x, y, z = r * math.cos(phi) * math.cos(theta), r * math.cos(phi) * math.sin(theta), r * math.sin(phi)
        found.append(body_T_radar[:3, :3] @ np.array([x, y, z]) + body_T_radar[:3, 3])
    return np.array(found)


def plain_stereo(rig: Rig, left: Pixels, right: Pixels) -> Float64:
    """Rectification and matching at full size, in all eight directions, and a point for each pixel that matched."""
    pair = pairs(rig)[0]
    how = rectify(rig, pair)
    one, other = how.images(left, right)
    matcher = cv2.StereoSGBM.create(0, 64, 5, 200, 800, mode=cv2.STEREO_SGBM_MODE_HH)
    disparity = np.asarray(matcher.compute(one, other), np.float64) / 16
    v, u = np.nonzero(disparity > 0)
    K, depth = how.camera.K, how.camera.K[0, 0] * how.baseline_m / disparity[v, u]
    return transform(rig.body_T_sensor(pair.left), np.stack(
        [(u - K[0, 2]) * depth / K[0, 0], (v - K[1, 2]) * depth / K[1, 1], depth], axis=1
    ))  # fmt: skip


def run_stereo(rig: Rig, frames: Sequence[Frame], num_threads: int) -> None:
    """Match without decoding, which is another stage, on so many threads."""
    cv2.setNumThreads(num_threads)
    stage = StereoStage(rig, "drive", StereoParams())
    for frame in frames:
        stage.view(frame, StageClock(), [])
    cv2.setNumThreads(NUM_CORES)


def message_of(frame: Frame, kind: type) -> Array | Image | PointCloud | RadarScan:
    return next(message for message in frame.messages.values() if isinstance(message, kind))  # type: ignore[return-value]


def reference_table(log: Path, stereo_log: Path) -> None:
    """Print each component against a plain reference, by CPU time, since that holds on a busy machine, too; and on one
    thread against two, by wall time. All are the shortest of some turns, in which all run one after another.
    """
    cv2.setNumThreads(1)
    rig, frames = first_frames(log, NUM_COMPARED)
    pair_rig, pair_frames = first_frames(stereo_log, NUM_COMPARED)
    lidar = LidarParams()
    clusters = [
        obstacles(transform(rig.body_T_sensor("lidar"), message_of(f, PointCloud).xyz), lidar).xyz[:, :2]  # type: ignore[union-attr]
        for f in frames
    ]
    clusters = [np.ascontiguousarray(points) for points in clusters]
    reference = DBSCAN(eps=lidar.cluster.eps_m, min_samples=lidar.cluster.min_points)
    radar = RadarStage(rig, open_log(log).info, RadarParams(), SensorSettings(Radar3DParams(), rig))
    grey = [[decode_grey(f.messages[name]) for name in STEREO] for f in pair_frames]  # type: ignore[arg-type]
    detectors = {num: make_detector(num) for num in (1, 2)}
    pixels = [decode(message_of(f, Image)) for f in frames]  # type: ignore[arg-type]

    def each(work: Callable[..., object], items: Sequence[object]) -> Callable[[], object]:
        return lambda: [work(item) for item in items]

    parts: dict[str, dict[str, Callable[[], object]]] = {
        f"DBSCAN, {np.mean([len(one) for one in clusters]):.0f} points; plain: scikit-learn": {
            "plain": each(reference.fit, clusters),
            "one": each(lambda xy: dbscan(xy, lidar.cluster.eps_m, lidar.cluster.min_points), clusters),
        },
        "radar preprocessing; plain: a loop over echoes": {
            "plain": each(lambda f: plain_echoes(message_of(f, RadarScan), rig.body_T_sensor("radar")), frames),  # type: ignore[arg-type]
            "one": each(lambda f: radar.echoes(f, StageClock()), frames),
        },
        "stereo; plain: full size, eight directions": {
            "plain": each(lambda both: plain_stereo(pair_rig, *both), grey),
            "one": partial(run_stereo, pair_rig, pair_frames, 1), "two": partial(run_stereo, pair_rig, pair_frames, 2),
        },
        "detector": {
            name: each(lambda image, own=own: own.infer(own.prepare(image)), pixels)
            for name, own in zip(("one", "two"), detectors.values(), strict=True)
        },
    }  # fmt: skip
    print(f"\n## Before and after\n\n{NUM_COMPARED} frames, the shortest of {ROUNDS} turns, ms a frame.\n")
    line("component", "plain reference, CPU", "ours, CPU", "plain / ours", "one thread / two, wall")
    line("---", *["---:"] * 4)
    for name, functions in parts.items():
        for function in functions.values():
            function()  # compiles
        cpu = best_by_turns_s({key: functions[key] for key in functions if key != "two"}, ROUNDS, time.process_time)
        wall = best_by_turns_s({key: functions[key] for key in functions if key != "plain"}, ROUNDS)
        ms = [f"{1e3 * cpu[key] / NUM_COMPARED:.2f}" if key in cpu else "–" for key in ("plain", "one")]
        ratio = f"{cpu['plain'] / cpu['one']:.1f}" if "plain" in cpu else "–"
        line(name, *ms, ratio, f"{wall['one'] / wall['two']:.2f}" if "two" in wall else "–")


def make_detector(num_threads: int) -> CameraDetector:
    with threads(num_threads):
        return CameraDetector(CameraParams(weights=CITY_WEIGHTS, threads=num_threads))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the drive")
    parser.add_argument("--log", type=Path, help="another with camera, LiDAR and radar")
    parser.add_argument("--stereo-log", type=Path, help="another with a stereo pair")
    parser.add_argument("--only", choices=("frames", "components", "references"), help="one of the tables")
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:NUM_CORES])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = args.log or write_drive(folder / f"urban-{SEED}.mcap", "urban", args.seconds, SEED)
        pair = args.stereo_log or write_drive(folder / f"stereo-{SEED}.mcap", "urban", STEREO_S, SEED, STEREO)
        host = describe_host()
        load = f"load {os.getloadavg()[0]:.1f}"
        print(f"# Run times, ms\n\n{host['cpu']}, {len(os.sched_getaffinity(0))} of its cores, {load}.")
        if args.only in (None, "frames"):
            frame_table(log, folder)
        if args.only in (None, "components"):
            component_table(log, pair, folder)
        if args.only in (None, "references"):
            reference_table(log, pair)


if __name__ == "__main__":
    main()
