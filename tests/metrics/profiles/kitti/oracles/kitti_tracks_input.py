"""Made-up KITTI tracking sequences: truth with vans, people, occlusion and "don't care" regions, and disturbed results.

Text as KITTI's files hold it (17 columns, results 18), so that the reference and the tests read the same numbers.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

SEQUENCES = {"0001": 60, "0006": 45, "0013": 30}
"""Name and number of frames."""
_SIZES = {"Car": (1.5, 1.65, 3.9), "Van": (2.2, 1.9, 5.1), "Pedestrian": (1.75, 0.65, 0.8),
          "Person_sitting": (1.3, 0.6, 0.8), "Cyclist": (1.7, 0.6, 1.75), "Truck": (3.2, 2.6, 9.0)}  # fmt: skip
_KINDS = ("Car", "Car", "Car", "Van", "Pedestrian", "Pedestrian", "Person_sitting", "Cyclist", "Cyclist", "Truck")
_FOCAL, _CU, _CV = 721.5, 609.6, 172.9


@dataclass
class _Body:
    """One road user and how well it is seen."""

    kind: str
    seen_as: str
    place: np.ndarray
    speed: np.ndarray
    size: np.ndarray
    heading: float
    turn: float
    confidence: float
    truncated: int
    occluded: int

    @classmethod
    def made(cls, rng: np.random.Generator, kind: str, crowding: float) -> "_Body":
        return cls(
            kind,
            "Van" if kind == "Truck" else "Car" if kind == "Van" and rng.random() < 0.5 else kind,
            np.array([rng.uniform(-crowding, crowding), rng.uniform(1.4, 1.8), rng.uniform(6, 50)]),
            rng.normal(0, 0.35, 3) * [1, 0, 1],
            np.array(_SIZES[kind]) * rng.uniform(0.9, 1.1, 3),
            rng.uniform(-np.pi, np.pi),
            rng.normal(0, 0.03),
            rng.normal(2.0, 2.0),
            int(rng.random() < 0.1),
            int(rng.choice([0, 1, 2, 3], p=[0.6, 0.2, 0.1, 0.1])),
        )

    def move(self, rng: np.random.Generator) -> None:
        """Go on by a frame."""
        self.place, self.heading = self.place + self.speed, self.heading + self.turn
        if rng.random() < 0.05:
            self.occluded = int(rng.integers(0, 4))

    def label(self, frame: int, track: int) -> str:
        return _row(
            frame, track, self.kind, self.truncated, self.occluded, self.size, self.place, self.heading
        )  # fmt: skip

    def results(self, rng: np.random.Generator, frame: int, track: int) -> list[str]:
        """Return the result, and now and then a double that competes for the same truth."""
        shifted = self.place + rng.normal(0, 0.12, 3) * [1, 0.3, 1]
        scaled = self.size * rng.uniform(0.93, 1.07, 3)
        score = self.confidence + rng.normal(0, 0.8)
        turned = self.heading + rng.normal(0, 0.05)
        rows = [_row(frame, track, self.seen_as, -1, -1, scaled, shifted, turned) + f" {score:.6f}"]
        if rng.random() < 0.08:
            shifted = shifted + rng.normal(0, 0.2, 3) * [1, 0, 1]
            double = _row(frame, track + 500_000, self.seen_as, -1, -1, scaled, shifted, self.heading)
            rows.append(double + f" {score - 1:.6f}")
        return rows


def made_sequence(seed: int, num_frames: int, crowding: float = 14.0) -> tuple[list[str], list[str]]:
    """Return the lines of truth and of results.

    Args:
        seed: For Philox.
        num_frames: Length.
        crowding: Half the width of the scene [m]: less puts boxes closer together.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    truth, results = _regions(rng, num_frames), _ghosts(rng, num_frames, crowding)
    for track, kind in enumerate(_KINDS * 2):
        body, found_as = _Body.made(rng, kind, crowding), 1000 * (track + 1)
        start = int(rng.integers(0, num_frames // 2))
        for frame in range(start, start + int(rng.integers(3, num_frames - start + 1))):
            body.move(rng)
            if rng.random() < 0.03:
                continue  # a gap in the truth
            truth.append(body.label(frame, track))
            found_as += int(rng.random() < 0.03)  # the tracker loses it
            if rng.random() > 0.12:
                results += body.results(rng, frame, found_as)
    return _ordered(truth), _ordered(results)


def _ghosts(rng: np.random.Generator, num_frames: int, crowding: float) -> list[str]:
    """Tracks of what isn't there."""
    results = []
    for ghost in range(8):
        kind = str(rng.choice(["Car", "Van", "Pedestrian", "Person_sitting", "Cyclist"]))
        place = np.array([rng.uniform(-crowding, crowding), 1.6, rng.uniform(8, 70)])
        confidence = rng.normal(-0.5, 2.0)
        for frame in range(int(rng.integers(0, num_frames)), num_frames):
            if rng.random() < 0.5:
                row = _row(frame, 900_000 + ghost, kind, -1, -1, np.array(_SIZES[kind]), place, 0.3)
                results.append(row + f" {confidence + rng.normal():.6f}")
    return results


def _regions(rng: np.random.Generator, num_frames: int) -> list[str]:
    """Up to two "don't care" regions a frame."""
    rows = []
    for frame in range(num_frames):
        for _ in range(int(rng.integers(0, 3))):
            left, top = rng.uniform(0, 1000), rng.uniform(120, 200)
            edges = (left, top, left + rng.uniform(30, 250), top + rng.uniform(20, 120))
            numbers = " ".join(f"{edge:.2f}" for edge in edges)
            rows.append(f"{frame} -1 DontCare -1 -1 -10 {numbers} -1 -1 -1 -1000 -1000 -1000 -10")
    return rows


def _ordered(lines: list[str]) -> list[str]:
    return sorted(lines, key=lambda line: int(line.split(" ", 1)[0]))


def _row(
    frame: int,
    track: int,
    kind: str,
    truncated: int,
    occluded: int,
    size: np.ndarray,
    place: np.ndarray,
    heading: float,
) -> str:
    """One line of a label file; `size` is height, width, length, `place` the middle of the bottom, camera axes."""
    height, width, length = size
    left, top, right, bottom = _rectangle(size, place)
    heading = float((heading + np.pi) % (2 * np.pi) - np.pi)
    alpha = heading - float(np.arctan2(place[0], place[2]))
    return (
        f"{frame} {track} {kind} {truncated} {occluded} {alpha:.6f} {left:.6f} {top:.6f} {right:.6f} {bottom:.6f} "
        f"{height:.6f} {width:.6f} {length:.6f} {place[0]:.6f} {place[1]:.6f} {place[2]:.6f} {heading:.6f}"
    )


def _rectangle(size: np.ndarray, place: np.ndarray) -> tuple[float, float, float, float]:
    depth, reach = max(float(place[2]), 1.0), max(size[1], size[2]) / 2
    left, right = (_FOCAL * (place[0] + side * reach) / depth + _CU for side in (-1, 1))
    top, bottom = (_FOCAL * y / depth + _CV for y in (place[1] - size[0], place[1]))
    return float(left), float(top), float(right), float(bottom)


def disturbed(truth: list[str], seed: int) -> list[str]:
    """Return results made from the lines of a real truth: moved, lost, switched and made-up boxes with scores."""
    rng = np.random.Generator(np.random.Philox(seed))
    confidence: dict[int, float] = {}
    number: dict[int, int] = {}
    results = []
    for fields in (line.split() for line in truth):
        track, kind = int(fields[1]), fields[2]
        if kind not in _SIZES or rng.random() < 0.1:
            continue
        confidence.setdefault(track, float(rng.normal(3, 2)))
        number.setdefault(track, track)
        if rng.random() < 0.01:
            number[track] += 1000
        v = np.array([float(x) for x in fields[6:17]])
        v[:4] += rng.normal(0, 2, 4)
        v[2:4] = np.maximum(v[2:4], v[:2] + 1)
        v[4:7] *= rng.uniform(0.92, 1.08, 3)
        v[7:10] += rng.normal(0, 0.12, 3)
        v[10] += rng.normal(0, 0.05)
        kind = "Van" if kind == "Car" and rng.random() < 0.03 else kind
        results.append(_result(fields[0], number[track], kind, v, confidence[track] + rng.normal(0, 0.7)))
        if rng.random() < 0.1:
            v[:4] += rng.normal(0, 30, 1)
            v[7:10:2] += rng.normal(0, 0.6, 2)
            results.append(_result(fields[0], number[track] + 500_000, kind, v, rng.normal(0, 2)))
    return results


def disturbed_folder(labels: Path, seqmap: Path, results: Path) -> None:
    """Write results for the sequences of a list, seeded by their numbers."""
    results.mkdir(parents=True, exist_ok=True)
    for name in (line.split()[0] for line in seqmap.read_text().splitlines()):
        rows = disturbed((labels / f"{name}.txt").read_text().splitlines(), int(name))
        (results / f"{name}.txt").write_text("\n".join(rows) + "\n")


def _result(frame: str, track: int, kind: str, numbers: np.ndarray, score: float) -> str:
    return f"{frame} {track} {kind} -1 -1 -10 " + " ".join(f"{x:.6f}" for x in numbers) + f" {score:.6f}"
