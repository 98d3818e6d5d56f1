"""Folders like KITTI's raw drives and nuScenes: noisy images, and clouds with as many digits as the sets have."""

import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fbench.replay.data.images import encode_jpeg

RNG = np.random.Generator(np.random.Philox(1))
Rows = list[dict[str, Any]]


def noise(height: int, width: int) -> Any:
    small = cv2.resize(RNG.integers(0, 255, (height // 8, width // 8, 3)).astype(np.uint8), (width, height))
    return np.clip(small + RNG.normal(0, 6, small.shape), 0, 255).astype(np.uint8)


def clouds(num_points: int, num_columns: int) -> list[bytes]:
    made = []
    for _ in range(4):
        cloud = np.round(RNG.normal(0, 20, (num_points, num_columns)), 3).astype("<f4")
        cloud[:, 3] = np.round(np.abs(cloud[:, 3])) % 256
        made.append(cloud.tobytes())
    return made


def make_kitti(root: Path, num_bytes: float) -> Path:
    """One raw drive: four cameras, LiDAR, poses."""
    drive = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    cameras = [f"image_{i:02d}" for i in range(4)]
    images = [cv2.imencode(".png", noise(375, 1242))[1].tobytes() for _ in range(4)]
    sweeps = clouds(120_000, 4)
    oxts = " ".join(["49.015", "8.434", "116.4", "0.035", "-0.0034", "0.3", *["1.5"] * 19, "4", "10", "4", "4", "0"])
    num = max(10, int(num_bytes / (4 * len(images[0]) + len(sweeps[0]))))
    for name in (*cameras, "velodyne_points", "oxts"):
        (drive / name / "data").mkdir(parents=True)
        stamps = (f"2011-09-26 13:{2 + i // 600:02d}:{i // 10 % 60:02d}.{i % 10}00000000\n" for i in range(num))
        (drive / name / "timestamps.txt").write_text("".join(stamps))
    for i in range(num):
        for k, name in enumerate(cameras):
            (drive / name / "data" / f"{i:010d}.png").write_bytes(images[(i + k) % 4])
        (drive / "velodyne_points" / "data" / f"{i:010d}.bin").write_bytes(sweeps[i % 4])
        (drive / "oxts" / "data" / f"{i:010d}.txt").write_text(oxts)
    eye, zero = "1 0 0 0 1 0 0 0 1", "0 0 0"
    lines = [f"R_rect_00: {eye}"]
    for i in range(4):
        lines += [f"S_{i:02d}: 1392 512", f"K_{i:02d}: 960 0 690 0 960 250 0 0 1", f"D_{i:02d}: 0 0 0 0 0"]
        lines += [f"R_{i:02d}: {eye}", f"T_{i:02d}: {zero}", f"S_rect_{i:02d}: 1242 375"]
        lines += [f"R_rect_{i:02d}: {eye}"] * (i > 0) + [f"P_rect_{i:02d}: 720 0 610 0 0 720 170 0 0 0 1 0"]
    velo, imu = f"R: 0 -1 0 0 0 -1 1 0 0\nT: {zero}\n", f"R: {eye}\nT: {zero}\n"
    texts = {"cam_to_cam": "\n".join(lines) + "\n", "velo_to_cam": velo, "imu_to_velo": imu}
    for name, text in texts.items():
        (drive.parent / f"calib_{name}.txt").write_text(text)
    return root


def token(*names: object) -> str:
    return hashlib.md5("/".join(map(str, names)).encode(), usedforsecurity=False).hexdigest()


def make_nuscenes(root: Path, num_bytes: float) -> Path:
    """One scene of keyframes: six cameras, LiDAR, five radars, 40 boxes in each."""
    cameras = [encode_jpeg(noise(900, 1600), 85) for _ in range(4)]
    sweeps = clouds(34_000, 5)
    for i, sweep in enumerate(sweeps):
        cloud = np.frombuffer(sweep, "<f4").reshape(-1, 5).copy()
        cloud[:, 4] = np.arange(len(cloud)) % 32
        sweeps[i] = cloud.tobytes()
    content = {f"CAM_{i}": ("camera", "jpg", cameras) for i in range(6)}
    content["LIDAR_TOP"] = ("lidar", "pcd.bin", sweeps)
    content |= {f"RADAR_{i}": ("radar", "pcd", [radar_pcd()]) for i in range(5)}
    num = max(10, int(num_bytes / (6 * len(cameras[0]) + len(sweeps[0]))))
    pose = {"translation": [0.0, 0, 0], "rotation": [1.0, 0, 0, 0]}
    tables: dict[str, Rows] = {name: [] for name in ("sample", "sample_data", "ego_pose", "sample_annotation")}
    tables["sensor"] = [{"token": c, "channel": c, "modality": kind} for c, (kind, _, _) in content.items()]
    intrinsic = [[1200.0, 0, 800], [0, 1200, 450], [0, 0, 1]]
    tables["calibrated_sensor"] = [
        {"token": c, "sensor_token": c, **pose, "camera_intrinsic": intrinsic if kind == "camera" else []}
        for c, (kind, _, _) in content.items()
    ]
    for i in range(num):
        add_sample(root, tables, content, i, num)
    tables["instance"] = [{"token": f"i{k}", "category_token": "car"} for k in range(40)]
    tables["category"] = [{"token": "car", "name": "vehicle.car"}]
    tables["attribute"] = [{"token": "moving", "name": "vehicle.moving"}]
    tables["visibility"] = [{"token": "4", "level": "v80-100"}]
    tables["log"] = [{"token": "log", "logfile": "n0", "vehicle": "n0", "date_captured": "", "location": "here"}]
    ends = {"first_sample_token": token("sample", 0), "last_sample_token": token("sample", num - 1)}
    tables["scene"] = [{"token": "s", "name": "scene-0001", "log_token": "log", "nbr_samples": num, **ends}]
    (root / "v1.0-mini").mkdir()
    for name, rows in tables.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows, indent=0))
    return root


def add_sample(root: Path, tables: dict[str, Rows], content: dict[str, Any], i: int, num: int) -> None:
    def link(*names: object) -> dict[str, str]:
        before, after = token(*names, i - 1) if i else "", token(*names, i + 1) if i + 1 < num else ""
        return {"token": token(*names, i), "prev": before, "next": after}

    us, own = 1_532_402_927_000_000 + 500_000 * i, token("sample", i)
    pose = {"translation": [0.0, 0, 0], "rotation": [1.0, 0, 0, 0]}
    tables["sample"].append({**link("sample"), "scene_token": "s", "timestamp": us})
    for channel, (kind, ending, files) in content.items():
        name = f"samples/{channel}/{i:06d}.{ending}"
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(files[i % len(files)])
        size = {"width": 1600, "height": 900} if kind == "camera" else {"width": 0, "height": 0}
        row = link("data", channel)
        links = {"sample_token": own, "ego_pose_token": row["token"], "calibrated_sensor_token": channel}
        tables["sample_data"].append(
            {**row, **links, **size, "timestamp": us, "is_key_frame": True, "filename": name, "fileformat": ending}
        )
        tables["ego_pose"].append({"token": row["token"], "timestamp": us, **pose})
    for k in range(40):
        refs = {"sample_token": own, "instance_token": f"i{k}", "visibility_token": "4", "attribute_tokens": ["moving"]}
        box = {**pose, "size": [2.0, 4.0, 1.5], "num_lidar_pts": 5, "num_radar_pts": 1}
        tables["sample_annotation"].append({**link("box", k), **refs, **box})


def radar_pcd() -> bytes:
    names = "x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 "
    header = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {names}vx_rms vy_rms\nSIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1\n"
        f"TYPE F F F I I F F F F F I I I I I I I I\nCOUNT{' 1' * 18}\nWIDTH 125\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 125\nDATA binary\n"
    )
    floats = RNG.normal(0, 20, (125, 8)).astype("<f4")
    flags = bytes([1, 3, 20, 20, 0, 1, 16, 3])
    ids = (bytes([0]) + i.to_bytes(2, "little") for i in range(len(floats)))
    return header.encode() + b"".join(
        f[:3].tobytes() + own + f[3:].tobytes() + flags for f, own in zip(floats, ids, strict=True)
    )
