"""`track` against a plain tracker, written as one would with scipy: one object a track, loops over pairs.

Times are those of the CPU. Both follow the same cars by constant velocity in 3D and the Hungarian method, at about as
many detections a frame as KITTI's sequences have (5) and more. The plain one associates by distance and knows no
labels, sizes or scores; that would only slow it down.
"""

import time

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.pipelines.tracking.tracker3d import Tracker3D
from fbench.pipelines.variants.recorded import TrackParams
from fbench.replay.data.boxes import Boxes3D

PERIOD_NS = 100_000_000


class PlainTrack:
    """One car: mean, covariance, hits and misses."""

    def __init__(self, place: np.ndarray) -> None:
        self.mean, self.cov = np.concatenate([place, np.zeros(3)]), np.diag([0.09] * 3 + [100.0] * 3)
        self.hits, self.missed = 1, 0

    def predict(self, dt_s: float) -> None:
        step, noise = np.eye(6), np.eye(6)
        step[:3, 3:] = dt_s * np.eye(3)
        noise[:3, :3] *= 25 * dt_s**3 / 3
        noise[3:, 3:] *= 25 * dt_s
        noise[:3, 3:] = noise[3:, :3] = 25 * dt_s**2 / 2 * np.eye(3)
        self.mean, self.cov = step @ self.mean, step @ self.cov @ step.T + noise
        self.missed += 1

    def update(self, place: np.ndarray) -> None:
        look = np.eye(3, 6)
        gain = self.cov @ look.T @ np.linalg.inv(look @ self.cov @ look.T + 0.09 * np.eye(3))
        self.mean, self.cov = self.mean + gain @ (place - self.mean[:3]), (np.eye(6) - gain @ look) @ self.cov
        self.hits, self.missed = self.hits + 1, 0


def plain(frames: list[Boxes3D]) -> int:
    tracks: list[PlainTrack] = []
    shown = 0
    for boxes in frames:
        for track in tracks:
            track.predict(0.1)
        cost = np.array([[np.linalg.norm(t.mean[:3] - place) for place in boxes.center_m] for t in tracks])
        pairs = zip(*linear_sum_assignment(cost), strict=True) if cost.size else ()
        taken = set()
        for row, column in pairs:
            if cost[row, column] < 3.8:
                tracks[row].update(boxes.center_m[column])
                taken.add(column)
        tracks = [t for t in tracks if not t.missed or (t.hits >= 2 and t.missed <= 3)]
        tracks += [PlainTrack(place) for k, place in enumerate(boxes.center_m) if k not in taken]
        shown += sum(t.hits >= 2 for t in tracks)
    return shown


def fast(frames: list[Boxes3D]) -> int:
    tracker = Tracker3D(TrackParams().tracking, any_order=True)
    return sum(len(tracker.step(boxes, (i + 1) * PERIOD_NS, None)) for i, boxes in enumerate(frames))


def drive(num_frames: int, num_cars: int) -> list[Boxes3D]:
    rng = np.random.Generator(np.random.Philox(11))
    place, speed = rng.uniform(-60, 60, (num_cars, 2)), rng.uniform(-8, 8, (num_cars, 2))
    frames = []
    for _ in range(num_frames):
        place = (place + speed * 0.1 + 60) % 120 - 60
        seen = place[rng.random(num_cars) < 0.9]
        num = len(seen)
        center = np.column_stack([seen + rng.normal(0, 0.15, (num, 2)), np.zeros(num)])
        frames.append(
            Boxes3D(center, np.tile([4.2, 1.8, 1.6], (num, 1)), np.arctan2(*rng.normal(size=(2, num))),
                    label=np.full(num, "car"), score=rng.random(num))
        )  # fmt: skip
    return frames


def main() -> None:
    start = time.process_time()
    fast(drive(3, 5))
    print(f"track, first use (compiled or read from the cache): {time.process_time() - start:.2f} s")
    for num_cars in (5, 20, 50):
        frames = drive(300, num_cars)
        best = {}
        for name, run in (("track", fast), ("plain", plain)):
            times = []
            for _ in range(3):
                start = time.process_time()
                run(frames)
                times.append(time.process_time() - start)
            best[name] = min(times)
        own, other = best["track"], best["plain"]
        print(
            f"track, {num_cars} cars: {len(frames) / own:.0f} frames/s, {1e3 * own / len(frames):.2f} ms a frame; "
            f"plain scipy {len(frames) / other:.0f} frames/s: {other / own:.1f} times as fast"
        )


if __name__ == "__main__":
    main()
