"""Time of one step of both trackers with 50 objects, and how it compares with a tracker written object by object.

The objects move steadily and nine of ten are detected in a frame, so that tracks are missed, end and begin. The other
tracker has the same filters as matrices, one object at a time, and the same association by scipy; it knows no labels,
cameras or scores, which would only slow it down. Times are wall times of single steps, as latencies are; the ratio is
that of CPU times of whole drives in one process, so that it holds on a busy machine, too.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from common import best_s
from scipy.optimize import linear_sum_assignment

from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.geometry.iou import distance_bev, iou_2d

NUM_OBJECTS, NUM_FRAMES, PERIOD_NS = 50, 300, 100_000_000
DT_S = 0.1


class PlainTrack:
    """One object: z and its rates, with whole matrices."""

    def __init__(self, z: Float64, std: Float64, rate_std: Float64) -> None:
        self.mean, self.cov = np.concatenate([z, np.zeros(len(z))]), np.diag(np.concatenate([std, rate_std]) ** 2)
        self.hits, self.missed = 1, 0

    def predict(self, drift_std: Float64) -> None:
        num = len(drift_std)
        step, q = np.eye(2 * num), np.diag(drift_std**2)
        step[:num, num:] = DT_S * np.eye(num)
        noise = np.block([[q * DT_S**3 / 3, q * DT_S**2 / 2], [q * DT_S**2 / 2, q * DT_S]])
        self.mean, self.cov = step @ self.mean, step @ self.cov @ step.T + noise
        self.missed += 1

    def update(self, z: Float64, std: Float64) -> None:
        observe = np.eye(len(z), 2 * len(z))
        gain = self.cov @ observe.T @ np.linalg.inv(observe @ self.cov @ observe.T + np.diag(std**2))
        self.mean = self.mean + gain @ (z - observe @ self.mean)
        self.cov = (np.eye(2 * len(z)) - gain @ observe) @ self.cov
        self.hits, self.missed = self.hits + 1, 0


def unit(z: Float64) -> Float64:
    """What one box size means in an image."""
    return np.array([np.sqrt(z[2]), np.sqrt(z[2]), z[2], z[3]])


def measure(xyxy: Float64) -> Float64:
    size = xyxy[:, 2:] - xyxy[:, :2]
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / 2
    return np.column_stack([middle, size.prod(axis=1), size[:, 0] / size[:, 1]])


def corners(z: Float64) -> Float64:
    half = np.array([np.sqrt(z[2] * z[3]), np.sqrt(z[2] / z[3])]) / 2
    return np.concatenate([z[:2] - half, z[:2] + half])


def plain_2d(frames: Sequence[Boxes2D]) -> None:
    tracks: list[PlainTrack] = []
    for boxes in frames:
        z = measure(boxes.xyxy_px)
        for track in tracks:
            track.predict(0.5 * unit(track.mean))
        iou = iou_2d(np.array([corners(t.mean) for t in tracks]).reshape(-1, 4), boxes.xyxy_px)
        new = associate(tracks, z, np.where(iou >= 0.1, iou, 0.0), lambda row: 0.05 * unit(row))
        tracks = [t for t in tracks if not t.missed or (t.hits >= 2 and t.missed <= 2)]
        tracks += [PlainTrack(z[k], 0.05 * unit(z[k]), 2 * unit(z[k])) for k in new]


def plain_3d(frames: Sequence[Boxes3D]) -> None:
    tracks: list[PlainTrack] = []
    for boxes in frames:
        for track in tracks:
            track.predict(np.full(3, 5.0))
        far = distance_bev(np.array([t.mean[:3] for t in tracks]).reshape(-1, 3), boxes.center_m)
        gate_m = 3.0 + 0.8 * np.array([t.missed for t in tracks]).reshape(-1, 1)
        new = associate(tracks, boxes.center_m, np.maximum(1 - far / gate_m, 0.0), lambda row: np.full(3, 0.3))
        tracks = [t for t in tracks if not t.missed or (t.hits >= 2 and t.missed <= 2)]
        tracks += [PlainTrack(boxes.center_m[k], np.full(3, 0.3), np.full(3, 10.0)) for k in new]


def associate(
    tracks: list[PlainTrack], z: Float64, similarity: Float64, std: Callable[[Float64], Float64]
) -> list[int]:
    """Correct tracks by what belongs to them, and return which measurements belong to none."""
    taken = set()
    for row, column in zip(*linear_sum_assignment(similarity, maximize=True), strict=True):
        if similarity[row, column] > 0:
            tracks[row].update(z[column], std(z[column]))
            taken.add(int(column))
    return [k for k in range(len(z)) if k not in taken]


def images() -> list[Boxes2D]:
    rng = np.random.Generator(np.random.Philox(3))
    center, size = rng.uniform(0, 800, (NUM_OBJECTS, 2)), rng.uniform(20, 120, (NUM_OBJECTS, 2))
    speed, label = rng.uniform(-40, 40, (NUM_OBJECTS, 2)), np.array(["car", "pedestrian", "bicycle"])
    frames = []
    for _ in range(NUM_FRAMES):
        center = (center + speed * DT_S) % 800
        seen = rng.random(NUM_OBJECTS) < 0.9
        num, middle = int(seen.sum()), center[seen] + rng.normal(0, 1, (seen.sum(), 2))
        frames.append(
            Boxes2D(
                np.full(num, "front"), np.concatenate([middle - size[seen] / 2, middle + size[seen] / 2], axis=1),
                label=label[np.flatnonzero(seen) % 3], score=rng.random(num), distance_m=rng.uniform(1, 50, num),
                range_rate_mps=rng.uniform(-1, 1, num), sources=np.ones(num, np.uint8),
            )
        )  # fmt: skip
    return frames


def space(num_objects: int) -> list[Boxes3D]:
    rng = np.random.Generator(np.random.Philox(11))
    place, speed = rng.uniform(-60, 60, (num_objects, 2)), rng.uniform(-8, 8, (num_objects, 2))
    label, frames = np.array(["car", "pedestrian", "bicycle"]), []
    for _ in range(NUM_FRAMES):
        place = (place + speed * DT_S + 60) % 120 - 60
        seen = rng.random(num_objects) < 0.9
        num = int(seen.sum())
        center = np.column_stack([place[seen] + rng.normal(0, 0.15, (num, 2)), np.zeros(num)])
        frames.append(
            Boxes3D(center, np.tile([4.2, 1.8, 1.6], (num, 1)), rng.uniform(-3, 3, num),
                    label=label[np.flatnonzero(seen) % 3], score=rng.random(num), sources=np.ones(num, np.uint8))
        )  # fmt: skip
    return frames


def time_ms(step: Callable[[], object]) -> float:
    """Wall time [ms]."""
    start = time.perf_counter()
    step()
    return 1e3 * (time.perf_counter() - start)


def compare(name: str, num_objects: int, own: Callable[[int], list[float]], plain: Callable[[], None]) -> None:
    """Print figures of `own`, which takes how many frames to track."""
    first = time_ms(partial(own, 2))
    steps = own(NUM_FRAMES)
    ratio = best_s(plain, 3, time.process_time) / best_s(partial(own, NUM_FRAMES), 3, time.process_time)
    print(
        f"tracking {name}, {num_objects} objects: median {np.median(steps):.2f} ms, p99 {np.percentile(steps, 99):.2f} "
        f"ms a frame; {ratio:.1f} times as fast as object by object; first use {first:.0f} ms"
    )


def main() -> None:
    def track_2d(num: int, frames: Sequence[Boxes2D]) -> list[float]:  # Wall time [ms] of each step
        step = Tracker2D(Tracker2DParams()).step
        return [time_ms(partial(step, boxes, (i + 1) * PERIOD_NS)) for i, boxes in enumerate(frames[:num])]

    def track_3d(num: int, frames: Sequence[Boxes3D]) -> list[float]:
        step, pose = Tracker3D(Tracker3DParams()).step, np.eye(4)
        return [time_ms(partial(step, boxes, (i + 1) * PERIOD_NS, pose)) for i, boxes in enumerate(frames[:num])]

    flat = images()
    compare("2D", NUM_OBJECTS, partial(track_2d, frames=flat), partial(plain_2d, flat))
    for num_objects in (5, 20, NUM_OBJECTS):  # KITTI's sequences have about five
        deep = space(num_objects)
        compare("3D", num_objects, partial(track_3d, frames=deep), partial(plain_3d, deep))


if __name__ == "__main__":
    main()
