"""Logs that `fbench log simulate` wrote, read back whole, and plain numpy to check them with."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tests.program import fbench

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.open import open_log

RIG = """
[cameras.stereo_left]
translation_m = [2.0, 0.2, 1.0]
rate_hz = 5.0
size_wh = [480, 360]
[cameras.stereo_right]
translation_m = [2.0, -0.2, 1.0]
rate_hz = 5.0
size_wh = [480, 360]
[lidars.lidar]
translation_m = [0.0, 0.0, 2.0]
rate_hz = 10.0
points_per_s = 500000
[radars.radar]
translation_m = [2.0, 0.0, 1.0]
yaw_pitch_roll_deg = [0.0, -5.0, 0.0]
points_per_s = 250000
"""
"""The thesis's rig with fewer and smaller images."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log as a user reads it."""

    path: Path
    info: LogInfo
    rig: Rig
    messages: list[Message]
    """In their order."""
    truths: dict[int, Truth]
    """By stamp."""

    def of(self, sensor: str) -> dict[int, Message]:
        """All messages of a sensor, by stamp."""
        return {m.stamp_ns: m for m in self.messages if m.sensor == sensor}

    def clouds(self, sensor: str = "lidar") -> dict[int, PointCloud]:
        return {ns: m for ns, m in self.of(sensor).items() if isinstance(m, PointCloud)}

    def scans(self, sensor: str = "radar") -> dict[int, RadarScan]:
        return {ns: m for ns, m in self.of(sensor).items() if isinstance(m, RadarScan)}

    def images(self, sensor: str) -> dict[int, Image]:
        return {ns: m for ns, m in self.of(sensor).items() if isinstance(m, Image)}

    def poses(self) -> dict[int, Pose]:
        return {m.stamp_ns: m for m in self.messages if isinstance(m, Pose)}


def read(path: Path) -> Log:
    """Read a log whole; it must have no fault."""
    faults = FaultLog()
    log = open_log(path, faults)
    messages = [m for m in log.messages() if isinstance(m, Message)]
    truths = {t.stamp_ns: t for t in log.truths()}
    assert not faults.counts, faults.counts
    return Log(path, log.info, log.rig, messages, truths)


def simulated(folder: Path, name: str, *args: object) -> Log:
    """Simulate and read back."""
    path = folder / f"{name}.mcap"
    assert fbench("log", "simulate", *args, "-o", path) == 0
    return read(path)


def moved(dst_T_src: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Points (N, 3) in other coordinates."""
    return np.asarray(xyz, float) @ dst_T_src[:3, :3].T + dst_T_src[:3, 3]


def in_boxes(xyz: np.ndarray, boxes, grown_m: float = 0.0) -> np.ndarray:
    """Which points (N, 3) lie in which of B boxes (B, N), both in one coordinate frame."""
    found = []
    for center, size, yaw in zip(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, strict=True):
        d = xyz - center
        x = np.cos(yaw) * d[:, 0] + np.sin(yaw) * d[:, 1]
        y = np.cos(yaw) * d[:, 1] - np.sin(yaw) * d[:, 0]
        local = np.abs(np.stack([x, y, d[:, 2]], axis=1))
        found.append((local <= size / 2 + grown_m).all(axis=1))
    return np.array(found, bool).reshape(len(boxes.center_m), len(xyz))


def body_velocity(log: Log, stamp_ns: int) -> tuple[np.ndarray, float]:
    """Velocity (3,) of the ego vehicle in its own axes and its turn rate, by differences of the log's poses."""
    poses = log.poses()
    stamps = np.array(sorted(poses))
    k = int(np.clip(np.searchsorted(stamps, stamp_ns), 1, len(stamps) - 2))
    a, b = poses[stamps[k - 1]].world_T_body, poses[stamps[k + 1]].world_T_body
    seconds = (stamps[k + 1] - stamps[k - 1]) / 1e9
    turned = a[:3, :3].T @ b[:3, :3]
    here = poses[stamps[k]].world_T_body[:3, :3]
    return here.T @ (b[:3, 3] - a[:3, 3]) / seconds, float(np.arctan2(turned[1, 0], turned[0, 0]) / seconds)


def projected(log: Log, camera: str, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) and depths (N,) of points in body coordinates, u = f X / Z + c; NaN where not in the image."""
    model = log.rig.cameras[camera]
    p = moved(np.linalg.inv(log.rig.body_T_sensor(camera)), xyz)
    depth = np.where(p[:, 2] > 0.5, p[:, 2], np.nan)
    uv = p[:, :2] * model.K[0, 0] / depth[:, None] + model.K[:2, 2]
    outside = ~((uv >= 0) & (uv <= np.array(model.size_wh) - 1)).all(axis=1)
    uv[outside], depth[outside] = np.nan, np.nan
    return uv, depth


def pixels(image: Image) -> np.ndarray:
    """(H, W, 3) blue, green, red, 0 to 255."""
    return cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR)
