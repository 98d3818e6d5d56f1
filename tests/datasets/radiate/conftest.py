"""A tiny sequence in the layout of RADIATE, with known numbers."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

CALIBRATION = """
lidar_calib:
    T: [0.6, -0.1, 0.2]
    R: [0.1, -0.2, 0.3]
left_cam_calib:
    T: [0.3, -0.05, 0.25]
    R: [1.5, -0.5, 0.25]
    fx: 10.0
    fy: 11.0
    cx: 4.0
    cy: 3.0
    k1: -0.1
    k2: 0.02
    k3: 0
    p1: 0.001
    p2: 0.002
    res: [8, 6]
right_cam_calib:
    T: [0.42, -0.05, 0.25]
    R: [0.5, 0.5, 0.0]
    fx: 10.5
    fy: 11.5
    cx: 4.5
    cy: 3.5
    k1: 0
    k2: 0
    p1: 0
    p2: 0
    res: [8, 6]
stereo_calib:
    TX: -120.0
    TY: 1.0
    TZ: 2.0
    R: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
"""
NOTHING: list[object] = []
CAR = {"position": [566.0, 470.0, 12.0, 24.0], "rotation": 90.0}
PEOPLE = {"position": [600.0, 576.0, 10.0, 6.0], "rotation": -30.0}
OBJECTS = [
    {"id": 7, "class_name": "car", "bboxes": [CAR, CAR, NOTHING, CAR, CAR]},
    {"id": 9, "class_name": "group_of_pedestrians", "bboxes": [NOTHING, PEOPLE, NOTHING, NOTHING, NOTHING]},
]
SECOND = 1_574_859_771


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Radar frames 1 to 3, two sweeps, three left and two right images, five fixes; labels for five radar frames."""
    root = tmp_path / "fog_1_0"
    _stamps(root, "Navtech_Polar", f"1 {SECOND}.500000000", f"2 {SECOND}.750000000", f"3 {SECOND + 1}.7")
    for number in (1, 2, 3):
        write_png(root / f"Navtech_Polar/{number:06d}.png", polar())
    _stamps(root, "velo_lidar", f"2 {SECOND}.480000000", f"3 {SECOND}.580000000", f"9 {SECOND}.680000000")
    _write(root / "velo_lidar/000001.csv", "1,2,3,4,5\n")
    _write(root / "velo_lidar/000002.csv", "1.5,10,-1.25,7,31\n-2,20.125,0.1,255,0\n")
    _write(root / "velo_lidar/000003.csv", "0,1,0,0,1\n")
    for side in ("left", "right"):
        _stamps(root, f"zed_{side}", f"1 {SECOND}.490000000", f"2 {SECOND}.560000000")
        for number in (1, 2):
            write_png(root / f"zed_{side}/{number:06d}.png", np.full((6, 8, 3), number, np.uint8))
    _stamps(root, "GPS_IMU_Twist", *(f"{i} {SECOND}.{at}" for i, at in enumerate(("3", "500000003", "500000003"), 1)),
            f"4 {SECOND + 60}.000000000")  # fmt: skip
    for number in (1, 2, 3, 4):
        _write(root / f"GPS_IMU_Twist/{number:06d}.txt", fix(number))
    _write(root / "annotations/annotations.json", json.dumps(OBJECTS))
    _write(root / "meta.json", '{"name": "fog_1", "type": "fog", "set": "test", "version": "1.0"}')
    _write(root / "default-calib.yaml", CALIBRATION)
    return root


def polar() -> np.ndarray:
    """A polar image (576, 400): even clutter, and a target at range cell 94 a little left of ahead."""
    image = np.full((576, 400), 20, np.uint8)
    image[94, 399] = 120
    return image


def fix(number: int) -> str:
    """A fix that moves to the north by 1e-5 degrees a file, at 3 m/s to the north and 4 m/s to the east."""
    zeros = ["0.0,0.0,0.0"] * 3
    place, covariances = f"{55.9 + 1e-5 * (number - 1):.9f},-3.3,200.5", zeros * 3
    lines = [place, *zeros, "0.0,0.0,0.6,0.8", *zeros[:2], *covariances, "3.0,4.0,-0.1", "0.0,0.0,0.0"]
    return " \n".join(lines) + " \n"


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True, parents=True)
    assert cv2.imwrite(str(path), image)


def _stamps(root: Path, name: str, *rows: str) -> None:
    text = "".join(f"Frame: {int(row.split()[0]):06d} Time: {row.split()[1]}\n" for row in rows)
    _write(root / f"{name}.txt", text)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text(text)
