"""Scores of `track` on the ten sequences of KITTI that AB3DMOT doesn't evaluate on, for choosing its parameters.

    python benchmarks/bench_tracking_kitti.py KITTI_TRACKING [--set tracking.NAME=VALUE ...]

Detections of cars are PointRCNN's (`pointrcnn_car_val`). Those of pedestrians and cyclists are simulated: the labels,
moved, missed and scored with the statistics of the car detections, and, as clutter, the car detections that no label
explains. How often an object is detected depends on its distance and occlusion; misses, scores and errors last for
some frames. Prints a table in Markdown, scored by the rules of `kitti-3dmot` at 3D IoU 0.25.
"""

import argparse
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm

from fbench.datasets.kitti.labels import boxes_3d, sequence_results, sequence_rows, tracking_label
from fbench.metrics.profiles.kitti.track_passes import TrackRules, run_passes, track_table
from fbench.metrics.profiles.kitti.tracking import Kitti3dMot
from fbench.pipelines.tracking.trackers import Tracker3D
from fbench.pipelines.variants.recorded import TrackParams
from fbench.replay.contracts.importing import BadInput, FrameRange
from fbench.replay.contracts.profiles import Match
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.sequences import Objects, Sequence, Steps
from fbench.replay.formats.kitti import DONT_CARE
from fbench.replay.formats.objects import LabeledObject, to_boxes2d
from fbench.replay.geometry.iou import distance_bev

PERIOD_NS = 100_000_000
SIZES = {"pedestrian": (0.8, 0.65, 1.75), "cyclist": (1.75, 0.6, 1.7)}  # Length, width, height [m] of clutter
LABELS = {"car": "car", "pedestrian": "pedestrian", "cyclist": "bicycle"}
SEEDS = (1, 2)
MIN_HEIGHT_PX = 25.0
NEAR_M = 2.5  # Detections this near to a label belong to it

BANDS_M = (15, 30, 50)
DETECTED = ((0.94, 0.99, 0.98, 0.71), (0.97, 0.98, 0.90, 0.60), (0.97, 0.90, 0.76, 0.28), (0.74, 0.69, 0.60, 0.40))
SCORES = ((11.2, 11.6, 7.6, 3.5), (11.1, 10.4, 6.1, 3.1), (9.9, 7.5, 4.9, 1.8), (7.9, 5.8, 4.7, 1.6))
"""Share of cars detected and their mean score, by occlusion 0 to 3 and distance."""
SMALLER = 1.4  # Smaller objects look like cars that are farther away by this factor,
SCORE_SHARE = 0.35  # and their scores are lower
SCORE_STD, SCORE_KEPT, ERROR_KEPT = 1.25, 0.91, 0.6  # Spread, and correlations of a frame with the next
ERROR_M = (0.06, 0.035, 0.03)  # Standard deviations of centers at 0 m, twice that at 50 m


@dataclass(frozen=True, eq=False)
class Drive:
    """One sequence: labels and PointRCNN's detections of cars, frame by frame."""

    name: str
    labels: Many[Boxes3D]
    cars: Many[Boxes3D]


def read_drives(folder: Path) -> list[Drive]:
    validation = {line.split()[0] for line in (folder / "evaluate_tracking.seqmap.val").read_text().splitlines()}
    drives = []
    for path in sorted((folder / "label_02").glob("*.txt")):
        if path.stem in validation:
            continue
        rows = sequence_rows(path, tracking_label, FrameRange(), BadInput())
        found = sequence_results(folder / "pointrcnn_car_val", path.stem, FrameRange(), BadInput())
        num = max(rows.num_frames, found.num_frames if found else 0)
        labels = [rows.frames.get(i, ()) for i in range(num)]
        cars = [keep_cars((found.rows(i) if found else None) or (), labels[i]) for i in range(num)]
        drives.append(Drive(path.stem, [boxes_3d(each) for each in labels], cars))
    return drives


def keep_cars(found: Many[LabeledObject], labels: Many[LabeledObject]) -> Boxes3D:
    """Detections of a frame without those that the profile would excuse: at no label, and low or in a region."""
    boxes, truth, flat = boxes_3d(found), boxes_3d(labels), to_boxes2d(found).xyxy_px
    regions = to_boxes2d([row for row in labels if row.source_label == DONT_CARE]).xyxy_px
    kept = flat[:, 3] - flat[:, 1] > MIN_HEIGHT_PX
    for low_x, low_y, high_x, high_y in regions:
        across = np.minimum(flat[:, 2], high_x) - np.maximum(flat[:, 0], low_x)
        down = np.minimum(flat[:, 3], high_y) - np.maximum(flat[:, 1], low_y)
        area = (flat[:, 2:] - flat[:, :2]).prod(axis=1)
        kept &= np.maximum(across, 0) * np.maximum(down, 0) <= 0.5 * area
    if len(truth) and len(boxes):
        kept |= distance_bev(boxes.center_m, truth.center_m).min(axis=1) <= NEAR_M
    return boxes[kept]


def simulate(drive: Drive, kind: str, seed: int) -> list[Boxes3D]:
    """Detections of a class, frame by frame."""
    rng = np.random.Generator(np.random.Philox([seed, int(drive.name)]))
    memory: dict[int, tuple[float, np.ndarray]] = {}
    frames = []
    for labels, cars in zip(drive.labels, drive.cars, strict=True):
        rows = []
        for box in (labels[i : i + 1] for i in np.flatnonzero(names_of(labels) == kind)):
            row = detect(box, memory, rng)
            rows += [] if row is None else [row]
        clutter = cars
        if len(labels) and len(cars):
            clutter = cars[distance_bev(cars.center_m, labels.center_m).min(axis=1) > NEAR_M]
        size = np.array(SIZES[kind])
        rows += [(*clutter.center_m[i], *size, clutter.yaw_rad[i], scores_of(clutter)[i]) for i in range(len(clutter))]
        table = np.array(rows, np.float64).reshape(-1, 8)
        label = np.full(len(table), LABELS[kind])
        frames.append(Boxes3D(table[:, :3], table[:, 3:6], table[:, 6], label=label, score=table[:, 7]))
    return frames


def detect(
    box: Boxes3D, memory: dict[int, tuple[float, np.ndarray]], rng: np.random.Generator
) -> tuple[float, ...] | None:
    """Detection of one label, or none; `memory` has how well each track was seen, and its error."""
    track = -1 if box.track_id is None else int(box.track_id[0])
    seen, error = memory.get(track, (rng.normal(), rng.normal(size=3)))
    seen = SCORE_KEPT * seen + np.sqrt(1 - SCORE_KEPT**2) * rng.normal()
    error = ERROR_KEPT * error + np.sqrt(1 - ERROR_KEPT**2) * rng.normal(size=3)
    memory[track] = seen, error
    level = 3 if box.occlusion is None or np.isnan(box.occlusion[0]) else min(int(box.occlusion[0]), 3)
    far_m = SMALLER * float(np.hypot(*box.center_m[0, :2]))
    band = int(np.searchsorted(BANDS_M, far_m))
    if 0.8 * seen + 0.6 * rng.normal() < norm.ppf(1 - DETECTED[level][band]):
        return None
    center = box.center_m[0] + error * np.array(ERROR_M) * (1 + far_m / 50)
    size = box.size_lwh_m[0] * rng.uniform(0.92, 1.08, 3)
    yaw = box.yaw_rad[0] + rng.normal(0, 0.15) + (np.pi if rng.random() < 0.05 else 0.0)
    return (*center, *size, yaw, SCORE_SHARE * SCORES[level][band] + SCORE_STD * seen)


def names_of(boxes: Boxes3D) -> np.ndarray:
    """KITTI's class of each label, in lower case."""
    return np.zeros(0, "U1") if boxes.source_label is None else np.char.lower(boxes.source_label)


def scores_of(boxes: Boxes3D) -> np.ndarray:
    return np.zeros(len(boxes)) if boxes.score is None else boxes.score


def objects(frames: Many[Boxes3D], names: Many[np.ndarray]) -> Objects:
    unknown = {"track_id": np.int64(-1), "score": np.float64(0), "occlusion": np.nan, "truncation": np.nan}
    parts = [[getattr(boxes, name) for boxes in frames] for name in (*unknown, "center_m", "size_lwh_m", "yaw_rad")]
    for part, fill in zip(parts, unknown.values(), strict=False):
        part[:] = [np.full(len(b), fill) if own is None else own for own, b in zip(part, frames, strict=True)]
    track_id, score, occlusion, truncation, center, size, yaw = (np.concatenate(part) for part in parts)
    step = np.repeat(np.arange(len(frames)), [len(boxes) for boxes in frames])
    return Objects(
        step, np.concatenate(names).astype(np.str_), track_id, score, center_m=center, size_lwh_m=size, yaw_rad=yaw,
        occlusion=occlusion, truncation=truncation,
    )  # fmt: skip


def sequence_of(drive: Drive, detections: Many[Boxes3D], kind: str, params: TrackParams) -> Sequence:
    """Truth beside tracks. What regions excuse was left out before."""
    tracker = Tracker3D(params.tracking, any_order=True)
    tracks = [tracker.step(boxes, (i + 1) * PERIOD_NS) for i, boxes in enumerate(detections)]
    names = [np.full(len(boxes), kind) for boxes in tracks]
    truth = objects(drive.labels, [names_of(boxes) for boxes in drive.labels])
    return Sequence(drive.name, Steps.of_one_stream(len(tracks)), truth, objects(tracks, names))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    args = parser.parse_args()
    params, rules = apply_settings(TrackParams(), args.settings), TrackRules(Match("iou3d", 0.25))
    drives = read_drives(args.folder)
    print("| class | sAMOTA | MOTA | IDS | FRAG | FP | FN |\n|---|---|---|---|---|---|---|")
    for kind in Kitti3dMot().classes:
        parts = [(drive, drive.cars) for drive in drives]
        if kind.label != "car":
            own = [drive for drive in drives if any((names_of(boxes) == kind.label).any() for boxes in drive.labels)]
            parts = [(drive, simulate(drive, kind.label, seed)) for seed in SEEDS for drive in own]
        tables = [track_table(sequence_of(*part, kind.label, params), kind, rules) for part in parts]
        passes, best = run_passes(tables, rules.num_recalls)
        samota = 100 * sum(one.smota or 0.0 for one in passes) / rules.num_recalls
        mota = 100 * (best.mota or 0.0)
        print(f"| {kind.label} | {samota:.2f} | {mota:.2f} | {best.ids} | {best.frag} | {best.fp} | {best.fn} |")


if __name__ == "__main__":
    main()
