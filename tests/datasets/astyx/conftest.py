"""A tiny folder in the layout of the Astyx set, with known numbers."""

import json
from pathlib import Path

import numpy as np
import pytest

from fbench.replay.data.images import encode_jpeg

CALIBRATION = {
    "sensors": [
        {"sensor_uid": "radar_6455", "calib_data": {"T_to_ref_COS": np.eye(4).tolist()}},
        {
            "sensor_uid": "lidar_vlp16",
            "calib_data": {"T_to_ref_COS": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]},
        },
        {
            "sensor_uid": "camera_front",
            "calib_data": {
                "T_to_ref_COS": [[0, 0, 1, 0.1], [-1, 0, 0, 0.2], [0, -1, 0, 0.3], [0, 0, 0, 1]],
                "K": [[100, 0, 3], [0, 110, 2], [0, 0, 1]],
            },
        },
    ]
}


def _object(classname: str, wxyz: list[float], occlusion: int = 0) -> dict[str, object]:
    return {
        "classname": classname, "center3d": [10.0, 2.0, 0.5], "dimension3d": [4.0, 1.8, 1.5], "object_id": -1,
        "orientation_quat": wxyz, "occlusion": occlusion, "score": -1.0, "label_certainty": 1,
    }  # fmt: skip


OBJECTS = [
    _object("Car", [np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)], 2),
    _object("Person", [np.cos(0.1), 0, np.sin(0.1), 0]),
    _object("Towed Object", [np.cos(0.05), np.sin(0.05), 0, 0]),
    _object("Tram", [1, 0, 0, 0]),
]


@pytest.fixture
def astyx_folder(tmp_path: Path) -> Path:
    """Frames 7, 8 and 10: the hour turns in 7, 8 has no objects, 10 has nothing but LiDAR and calibration."""
    root = tmp_path / "set"
    for folder in ("camera_front", "lidar_vlp16", "radar_6455", "calibration", "groundtruth_obj3d", "extra"):
        (root / folder).mkdir(parents=True)
    _lidar(root, 7, "1 0 0 5 0 3599950000", "0 2 0 255 15 3599999999", "0 2 0 7 3 20000")
    _lidar(root, 8, "1.25 -0.5 0 0 0 50000")
    _lidar(root, 10, "1 0 0 5 1 150000")
    for number in (7, 8):
        picture = encode_jpeg(np.full((4, 6, 3), number, np.uint8))
        (root / f"camera_front/{number:06d}.jpg").write_bytes(picture)
        rows = "\nX Y Z V_r Mag\n10 1 0.5 2.5 46.5\n20 -3 0 -1 50\n5 0 0 0 40\n"
        (root / f"radar_6455/{number:06d}.txt").write_text(rows)
    for number in (7, 8, 10):
        (root / f"calibration/{number:06d}.json").write_text(json.dumps(CALIBRATION))
    (root / "groundtruth_obj3d/000007.json").write_text(json.dumps({"objects": OBJECTS}))
    (root / "groundtruth_obj3d/000008.json").write_text(json.dumps({"objects": []}))
    (root / "lidar_vlp16/notes.txt").write_text("not a frame")
    return root


def _lidar(root: Path, number: int, *rows: str) -> None:
    text = "X Y Z Reflectivity LaserID Timestamp \n" + "".join(f"{row}\n" for row in rows)
    (root / f"lidar_vlp16/{number:06d}.txt").write_text(text)
