"""KITTI tracking files, truth and results, made up from a seed."""

from pathlib import Path

import numpy as np

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_boxes

CALIB = """P0: 700 0 600 0 0 700 180 0 0 0 1 0
P1: 700 0 600 -350 0 700 180 0 0 0 1 0
P2: 700 0 600 42 0 700 180 0 0 0 1 0
P3: 700 0 600 -308 0 700 180 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3
Tr_imu_velo 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.7
"""
NUM_FRAMES = 25
CLASSES = ("Car", "Car", "Car", "Van", "Pedestrian", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc")
SIZES_HWL = {"Car": (1.5, 1.6, 4.0), "Van": (2.0, 1.9, 5.0), "Cyclist": (1.7, 0.6, 1.8), "Tram": (3.0, 2.5, 12.0)}
_NUM = 14
_FLAT_ONLY = "-1 -1 -1 -1000 -1000 -1000 -10"


def write_truth(root: Path, seed: int) -> None:
    """Labels of one sequence, 0000, with DontCare regions, and its calibration."""
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = []
    kinds = rng.choice(CLASSES, _NUM)
    start = np.column_stack([rng.uniform(-9, 9, _NUM), np.full(_NUM, 1.7), rng.uniform(16, 60, _NUM)])
    speed = np.column_stack([rng.uniform(-0.05, 0.05, _NUM), np.zeros(_NUM), rng.uniform(-0.3, 0.6, _NUM)])
    turn = rng.uniform(-np.pi, np.pi, _NUM)
    first, last = rng.integers(0, 6, _NUM), rng.integers(15, NUM_FRAMES, _NUM)
    for frame in range(NUM_FRAMES):
        left, top = rng.uniform(0, 900), rng.uniform(100, 200)
        rows.append(f"{frame} -1 DontCare -1 -1 -10 {left:.2f} {top:.2f} {left + 200:.2f} {top + 90:.2f} "
                    "-1000 -1000 -1000 -10 -1 -1 -1")  # fmt: skip
        for i in np.flatnonzero((first <= frame) & (frame <= last)):
            size, place = SIZES_HWL.get(kinds[i], (1.7, 0.6, 0.6)), start[i] + frame * speed[i]
            head = f"{frame} {i} {kinds[i]} {int(rng.random() < 0.1)} {rng.integers(0, 4)} {rng.uniform(-3, 3):.4f}"
            u, v = 600 + 700 * place[0] / place[2], 180 + 700 * (place[1] - size[0]) / place[2]
            box = (u - 500 / place[2], v, u + 500 / place[2], 180 + 700 * place[1] / place[2])
            rows.append(f"{head} {_text(box)} {_text([*size, *place, turn[i]])}")
    for name, text in (("label_02", "\n".join(rows) + "\n"), ("calib", CALIB)):
        (root / name).mkdir(parents=True, exist_ok=True)
        (root / name / "0000.txt").write_text(text)
    (root / "evaluate_tracking.seqmap").write_text(f"0000 empty 000000 {NUM_FRAMES:06d}\n")


def write_results(labels: Path, folder: Path, seed: int, rig: Rig | None) -> None:
    """Disturbed truth: with misses, switched ids, false alarms and wrong classes; in images alone where there is no
    rig, else in 3D with the rectangles around the projected boxes.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = [line.split() for line in labels.read_text().splitlines()]
    kept = [row for row in rows if row[2] != "DontCare" and rng.random() < 0.9]
    kept += [[*row[:1], str(500 + i), *row[2:]] for i, row in enumerate(kept[::9])]
    lines = []
    for row in kept:
        box, numbers = np.array(row[6:10], float), np.array(row[10:17], float)
        strength = 30 if int(row[1]) >= 500 else 1
        box = box + rng.normal(0, 2 * strength, 4) * (1, 1, 1, 1)
        box = np.array([*np.minimum(box[:2], box[2:]), *np.maximum(box[:2], box[2:])])
        numbers[3:6] += rng.normal(0, 0.1 * strength, 3) * (1, 0.2, 1)
        numbers[5] = max(numbers[5], 8.0)
        numbers[6] += rng.normal(0, 0.05)
        kind = "Car" if rng.random() < 0.05 else row[2]
        id_ = int(row[1]) + 100 * int(rng.random() < 0.03)
        if rig is not None and not _seen(rig, numbers):
            continue
        shape = _FLAT_ONLY if rig is None else _text(numbers)
        flat = _text(box if rig is None else _outline(rig, numbers))
        alpha = -10.0 if rig is None else numbers[6] - np.arctan2(numbers[3], numbers[5])
        lines.append(f"{row[0]} {id_} {kind} -1 -1 {float(alpha)!r} {flat} {shape} {float(rng.random())!r}")
    folder.mkdir(parents=True, exist_ok=True)
    unique = {tuple(line.split()[:2]): line for line in lines}
    (folder / f"{labels.stem}.txt").write_text("\n".join(unique.values()) + "\n")


def _text(numbers) -> str:
    return " ".join(repr(float(value)) for value in numbers)


def _box(numbers) -> Boxes3D:
    """One row's 3D box, in camera 0 turned upright."""
    height, width, length, x, y, z, rotation = numbers
    return Boxes3D(
        np.array([[z, -x, height / 2 - y]]), np.array([[length, width, height]]), np.array([-rotation - np.pi / 2])
    )


def _outline(rig: Rig, numbers):
    return project_boxes(rig, "image_02", _box(numbers))[0][0]


def _seen(rig: Rig, numbers) -> bool:
    return bool(project_boxes(rig, "image_02", _box(numbers))[1][0])
