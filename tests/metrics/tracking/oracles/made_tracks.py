"""Made-up truth and perturbed trackers in KITTI's and MOTChallenge's text: the same input for oracles and tests.

Needs numpy only, since it also runs in the environments of the oracles.
"""

from dataclasses import dataclass

import numpy as np

KITTI_NAMES = ("made0", "made1", "made2", "made3", "no_truth", "no_results", "nothing")
MOT_NAMES = ("mot0", "mot1", "mot2", "mot_no_results")
NUM_FRAMES = 36
_WIDTH, _HEIGHT = 1240.0, 370.0


@dataclass
class Box:
    """One box of one frame."""

    frame: int
    id: int
    kind: str
    xyxy: np.ndarray
    truncation: int = 0
    occlusion: int = 0
    flag: int = 1


def kitti_texts(name: str) -> tuple[str, str]:
    """Truth and results of a sequence, in KITTI's text."""
    rng = _rng(name)
    truth = [] if name in ("no_truth", "nothing") else _truth(rng, _kitti_kind, 14)
    results = [] if name in ("no_results", "nothing") else _results(rng, truth, ("Car", "Pedestrian"))
    return _text(map(_kitti_row, truth)), _text(f"{_kitti_row(box)} 0.9" for box in results)


def mot_texts(name: str) -> tuple[str, str]:
    """Truth and results of a sequence, in MOTChallenge's text: whole pixels, so that equal overlaps happen."""
    rng = _rng(name)
    truth = _truth(rng, _mot_kind, 18)
    for box in truth:
        box.flag = int(rng.random() < 0.9) if box.kind == "1" else 0
    results = [] if name == "mot_no_results" else _results(rng, truth, ("-1",))
    return _text(_mot_row(b, f"{b.flag},{b.kind},0.5") for b in truth), _text(
        _mot_row(b, "0.8,-1,-1,-1") for b in results
    )


def _rng(name: str) -> np.random.Generator:
    return np.random.Generator(np.random.Philox([ord(name[0]), ord(name[1]), sum(map(ord, name))]))


def _text(rows) -> str:
    return "".join(f"{row}\n" for row in rows)


def _kitti_kind(rng: np.random.Generator) -> str:
    return str(rng.choice(["Car", "Van", "Pedestrian", "Person", "Cyclist"], p=[0.45, 0.15, 0.25, 0.1, 0.05]))


def _mot_kind(rng: np.random.Generator) -> str:
    return str(rng.choice(["1", "2", "7", "8", "12", "6", "3"], p=[0.6, 0.08, 0.08, 0.08, 0.06, 0.05, 0.05]))


def _truth(rng: np.random.Generator, kind_of, num_tracks: int) -> list[Box]:
    """Tracks that come, go, hide for a while and cross each other, and DontCare regions in KITTI's."""
    boxes: list[Box] = []
    for id_ in range(num_tracks):
        kind = kind_of(rng)
        first, last = sorted(rng.integers(0, NUM_FRAMES + 1, 2))
        center, speed = rng.uniform([100, 120], [900, 260]), rng.normal(0, [9, 2])
        size = rng.uniform([25, 18], [220, 160])
        hidden = rng.integers(first, last + 1) if rng.random() < 0.4 else NUM_FRAMES
        truncation, occlusion = int(rng.random() < 0.1), int(rng.choice(4, p=[0.6, 0.2, 0.1, 0.1]))
        for frame in range(first, last):
            if hidden <= frame < hidden + 4 or frame in (10, 11):  # 10 and 11: no truth at all
                continue
            middle = center + speed * (frame - first)
            box = np.concatenate([middle - size / 2, middle + size / 2])
            if rng.random() < 0.1:
                occlusion = int(rng.integers(0, 4))
            boxes.append(Box(frame, id_, kind, box, truncation, occlusion))
    if kind_of is _kitti_kind:
        boxes += _regions(rng)
    return sorted(boxes, key=lambda box: box.frame)


def _regions(rng: np.random.Generator) -> list[Box]:
    corner = rng.uniform([0, 100], [900, 200])
    region = np.concatenate([corner, corner + np.array([300, 150])])
    return [Box(frame, -1, "DontCare", region, -1, -1) for frame in range(0, NUM_FRAMES, 2)]


def _results(rng: np.random.Generator, truth: list[Box], kinds: tuple[str, ...]) -> list[Box]:
    """Truth with jitter, misses, id switches and swaps, duplicates in place, and false alarms large and small."""
    boxes: list[Box] = []
    number = {box.id: 100 + box.id for box in truth}
    for box in truth:
        if box.kind == "DontCare" or box.frame in (20, 21) or rng.random() < 0.15:  # 20 and 21: no results at all
            continue
        if rng.random() < 0.04:
            number[box.id] = 1000 + len(boxes)
        if rng.random() < 0.03:
            other = int(rng.choice(sorted(number)))
            number[box.id], number[other] = number[other], number[box.id]
        size = np.tile(box.xyxy[2:] - box.xyxy[:2], 2)
        jitter = rng.choice([0, 0.03, 0.12, 0.3], p=[0.2, 0.4, 0.3, 0.1])
        kind = {"Van": "Car", "Person": "Pedestrian"}.get(box.kind, box.kind) if len(kinds) > 1 else kinds[0]
        xyxy = box.xyxy + rng.normal(0, jitter, 4) * size if jitter else box.xyxy
        xyxy = np.concatenate([xyxy[:2], np.maximum(xyxy[2:], xyxy[:2] + 2)])
        boxes.append(Box(box.frame, number[box.id], kind, xyxy))
        if rng.random() < 0.06:
            boxes.append(Box(box.frame, 5000 + box.id, kind, xyxy))
    boxes += [_false_alarm(rng, kinds) for _ in range(60)]
    return _without_double_ids(sorted(boxes, key=lambda box: box.frame))


def _false_alarm(rng: np.random.Generator, kinds: tuple[str, ...]) -> Box:
    corner, size = rng.uniform([0, 80], [1000, 250]), rng.uniform([10, 8], [150, 90])
    frame, id_ = int(rng.integers(0, NUM_FRAMES)), int(rng.integers(7000, 7012))
    return Box(frame, id_, str(rng.choice(kinds)), np.concatenate([corner, corner + size]))


def _without_double_ids(boxes: list[Box]) -> list[Box]:
    seen: set[tuple[int, int]] = set()
    kept = []
    for box in boxes:
        if (box.frame, box.id) not in seen and box.frame not in (20, 21):
            seen.add((box.frame, box.id))
            kept.append(box)
    return kept


def _kitti_row(box: Box) -> str:
    corners = " ".join(f"{value:.2f}" for value in box.xyxy)
    head = f"{box.frame} {box.id} {box.kind} {box.truncation} {box.occlusion} -10.00 {corners}"
    return f"{head} 1.50 1.60 3.90 -1000.00 -1000.00 -1000.00 -10.00"


def _mot_row(box: Box, tail: str) -> str:
    left, top, right, bottom = np.round(box.xyxy).astype(int)
    return f"{box.frame + 1},{box.id + 1},{left},{top},{max(right - left, 1)},{max(bottom - top, 1)},{tail}"
