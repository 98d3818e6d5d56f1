"""Tiny folders in the layouts of KITTI's benchmarks, with known numbers."""

from pathlib import Path

import cv2
import numpy as np
import pytest

TRACKING_CALIB = """P0: 700 0 50 0 0 700 20 0 0 0 1 0
P1: 700 0 50 -350 0 700 20 0 0 0 1 0
P2: 700 0 50 42 0 700 20 0 0 0 1 0
P3: 700 0 50 -308 0 700 20 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3
Tr_imu_velo 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.7
"""
OBJECT_CALIB = (
    TRACKING_CALIB.replace("R_rect", "R0_rect:").replace("velo_cam", "velo_to_cam:").replace("imu_velo", "imu_to_velo:")
)
CAR = "Car 0 1 -1.793451 10.5 5 60 30.25 1.5 2.0 4.0 3 1.6 20 0.5"
WALKER = "Pedestrian 2 3 0.1 1 2 3 4 1.75 0.5 0.75 -3 1.6 10 -1.5"
REGION = "DontCare -1 -1 -10.000000 0 0 9 9 -1000 -1000 -1000 -10 -1 -1 -1"
OBJECT_CAR = "Car 0.25 1 -1.79 10.5 5 60 30.25 1.5 2.0 4.0 3 1.6 20 0.5"
OBJECT_REGION = "DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10"
SIZE_WH = (100, 40)
POINTS = np.array([[1, 2, 3, 0.25], [4, 5, 6, 0.5]], "<f4")


def picture(number: int, size_wh: tuple[int, int] = SIZE_WH) -> bytes:
    _, data = cv2.imencode(".png", np.full((size_wh[1], size_wh[0], 3), number, np.uint8))
    return data.tobytes()


def oxts_row(lon_deg: float) -> str:
    return " ".join(["49.0", str(lon_deg), "116.0", "0", "0", "0", *["0"] * 24])


def write_tracking(root: Path) -> Path:
    """Sequence 0000 with 4 frames: labels in 0 and 2, images in all, no LiDAR in 1; 0001 with labels alone."""
    for name in ("label_02", "calib", "oxts", "image_02/0000", "velodyne/0000", "docs"):
        (root / name).mkdir(parents=True)
    (root / "label_02/0000.txt").write_text(f"0 -1 {REGION}\n0 7 {CAR}\n0 8 {WALKER}\n2 7 {CAR}\n")
    (root / "label_02/0001.txt").write_text(f"1 3 {CAR}\n")
    for sequence in ("0000", "0001"):
        (root / f"calib/{sequence}.txt").write_text(TRACKING_CALIB)
    for number in range(4):
        (root / f"image_02/0000/{number:06d}.png").write_bytes(picture(number))
    for number in (0, 2, 3):
        (root / f"velodyne/0000/{number:06d}.bin").write_bytes(POINTS.tobytes())
    (root / "oxts/0000.txt").write_text("".join(f"{oxts_row(8.0 + i * 1e-5)}\n" for i in range(4)))
    (root / "evaluate_tracking.seqmap.training").write_text("0000 empty 000000 000004\n0001 empty 000000 000003\n")
    return root


@pytest.fixture
def tracking_folder(tmp_path: Path) -> Path:
    return write_tracking(tmp_path / "set")


@pytest.fixture
def object_folder(tmp_path: Path) -> Path:
    """Frames 0, 1 and 5, the last one with another calibration and size; 1 has no object."""
    root = tmp_path / "objects"
    for name in ("label_2", "calib", "image_2", "velodyne"):
        (root / name).mkdir(parents=True)
    for number, rows in ((0, f"{OBJECT_CAR}\n{OBJECT_REGION}\n"), (1, ""), (5, f"{OBJECT_CAR}\n")):
        (root / f"label_2/{number:06d}.txt").write_text(rows)
        calibration = OBJECT_CALIB.replace("700", "650") if number == 5 else OBJECT_CALIB
        (root / f"calib/{number:06d}.txt").write_text(calibration)
        (root / f"image_2/{number:06d}.png").write_bytes(picture(number, (90, 30) if number == 5 else SIZE_WH))
        (root / f"velodyne/{number:06d}.bin").write_bytes(POINTS.tobytes())
    return root
