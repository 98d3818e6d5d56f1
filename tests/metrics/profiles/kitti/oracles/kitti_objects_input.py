"""Made-up frames of KITTI's object benchmark: labels and results as arrays, in the camera's axes."""

from dataclasses import dataclass

import numpy as np

_SIZES = {"Car": (1.5, 1.65, 3.9), "Van": (2.2, 1.9, 5.1), "Pedestrian": (1.75, 0.65, 0.8),
          "Person_sitting": (1.3, 0.6, 0.8), "Cyclist": (1.7, 0.6, 1.75), "Truck": (3.2, 2.6, 9.0)}  # fmt: skip


@dataclass(frozen=True)
class Rows:
    """Columns of one frame's label file; names as KITTI writes them."""

    name: np.ndarray
    truncated: np.ndarray
    occluded: np.ndarray
    alpha: np.ndarray
    bbox: np.ndarray
    lhw: np.ndarray
    location: np.ndarray
    rotation_y: np.ndarray
    score: np.ndarray


def made_frames(seed: int, num_frames: int, crowding: float = 12.0) -> list[tuple[Rows, Rows]]:
    """Return truth and results of each frame; less `crowding` [m] puts boxes closer together."""
    rng = np.random.Generator(np.random.Philox(seed))
    return [_frame(rng, crowding) for _ in range(num_frames)]


def _frame(rng: np.random.Generator, crowding: float) -> tuple[Rows, Rows]:
    truth: list[tuple[object, ...]] = []
    results: list[tuple[object, ...]] = []
    for _ in range(int(rng.integers(2, 14))):
        kind = str(rng.choice(list(_SIZES), p=[0.35, 0.1, 0.25, 0.05, 0.2, 0.05]))
        size = np.array(_SIZES[kind]) * rng.uniform(0.9, 1.1, 3)
        place = np.array([rng.uniform(-crowding, crowding), rng.uniform(1.4, 1.8), rng.uniform(5, 45)])
        turn = rng.uniform(-np.pi, np.pi)
        truncated = round(float(rng.choice([0, rng.uniform(0, 0.7)], p=[0.7, 0.3])), 2)
        truth.append((kind, truncated, int(rng.choice([0, 1, 2, 3], p=[0.5, 0.25, 0.15, 0.1])), size, place, turn, 0.0))
        for _ in range(int(rng.choice([0, 1, 2], p=[0.15, 0.7, 0.15]))):
            seen = str(rng.choice(list(_SIZES))) if rng.random() < 0.08 else kind
            spread = rng.choice([0.05, 0.15, 0.4])
            moved = place + rng.normal(0, spread, 3) * [1, 0.3, 1]
            angle = turn + rng.normal(0, 0.1) + (np.pi if rng.random() < 0.1 else 0)
            results.append((seen, -1, -1, size * rng.uniform(0.9, 1.1, 3), moved, angle, rng.normal(1 - spread, 1)))
    for _ in range(int(rng.integers(0, 5))):
        kind = str(rng.choice(["Car", "Pedestrian", "Cyclist"]))
        place = np.array([rng.uniform(-crowding, crowding), 1.6, rng.uniform(5, 60)])
        results.append((kind, -1, -1, np.array(_SIZES[kind]), place, rng.uniform(-3, 3), rng.normal(-0.7, 1)))
    regions = rng.uniform([0, 120, 40, 20], [1000, 200, 300, 160], (int(rng.integers(0, 3)), 4))
    return _rows(truth, regions), _rows(results, np.zeros((0, 4)))


def _rows(boxes: list[tuple[object, ...]], regions: np.ndarray) -> Rows:
    """Put boxes first, then "don't care" regions given by left, top, width, height."""
    num = len(regions)
    size = np.array([b[3] for b in boxes]).reshape(-1, 3)
    place = np.array([b[4] for b in boxes]).reshape(-1, 3)
    turn = np.array([(float(b[5]) + np.pi) % (2 * np.pi) - np.pi for b in boxes])
    corners = np.column_stack([regions[:, :2], regions[:, :2] + regions[:, 2:]])
    return Rows(
        name=np.array([b[0] for b in boxes] + ["DontCare"] * num, dtype="U20"),
        truncated=np.array([b[1] for b in boxes] + [-1] * num, float),
        occluded=np.array([b[2] for b in boxes] + [-1] * num, float),
        alpha=np.concatenate([turn - np.arctan2(place[:, 0], place[:, 2]), np.full(num, -10.0)]),
        bbox=np.vstack([_rectangles(size, place), corners]),
        lhw=np.vstack([size[:, [2, 0, 1]], np.full((num, 3), -1.0)]),
        location=np.vstack([place, np.full((num, 3), -1000.0)]),
        rotation_y=np.concatenate([turn, np.full(num, -10.0)]),
        score=np.array([b[6] for b in boxes] + [0.0] * num, float),
    )


def _rectangles(size: np.ndarray, place: np.ndarray) -> np.ndarray:
    reach, depth = np.maximum(size[:, 1], size[:, 2]) / 2, place[:, 2]
    left, right = (721.5 * (place[:, 0] + side * reach) / depth + 609.6 for side in (-1, 1))
    top, bottom = (721.5 * y / depth + 172.9 for y in (place[:, 1] - size[:, 0], place[:, 1]))
    return np.column_stack([left, top, right, bottom])
