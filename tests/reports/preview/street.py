"""A small street: textured walls, poles before them, and a rig that sees them."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.reports.preview.sample import Sample

UPRIGHT = np.array([0.0, 0, 0, 1])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
SIZE = (320, 200)
K = np.array([[200.0, 0, 159.5], [0, 200, 99.5], [0, 0, 1]])
POLES = [
    (float(x), float(y)) for x, y in zip(range(8, 30), np.tile([-3.0, 1.5, -0.8, 4.0, 2.4, -5.0], 4), strict=False)
]


def street_rig(left=0.0, right=None):
    """LiDAR and radar at the body's origin; cameras look ahead."""
    mounts = {"lidar": Mount("lidar", np.zeros(3), UPRIGHT), "radar": Mount("radar", np.zeros(3), UPRIGHT)}
    mounts["cam"] = Mount("camera", np.array([0, left, 0.0]), FORWARD)
    cameras = {"cam": CameraModel(K, SIZE)}
    if right is not None:
        mounts["cam2"] = Mount("camera", np.array([0, right, 0.0]), FORWARD)
        cameras["cam2"] = CameraModel(K, SIZE)
    return Rig(mounts, cameras)


@dataclass(frozen=True)
class Street:
    """Poles of 0.3 m before a wall at 40 m, seen from the origin."""

    poles: tuple[tuple[float, float], ...] = tuple(POLES)

    def depth_along(self, azimuth):
        """Distance in x (N,) of what is first hit in directions (N,) [rad]."""
        depth = np.full(len(azimuth), 40.0)
        for x, y in sorted(self.poles, reverse=True):
            hit = np.abs(np.tan(azimuth) * x - y) < 0.15
            depth[hit] = x
        return depth

    def image(self, seed=0):
        """Every pole in a gray of its own on a plain wall."""
        azimuth = -np.arctan((np.arange(SIZE[0]) - 159.5) / 200)
        depth = self.depth_along(azimuth)
        gray = np.where(depth < 40, 40 + depth * 5 % 60, 200).astype(np.uint8)
        return np.repeat(np.tile(gray, (SIZE[1], 1))[:, :, None], 3, axis=2)

    def cloud(self):
        """Points at steps of 0.2 degrees in azimuth, eleven rings."""
        azimuth, altitude = np.meshgrid(np.radians(np.arange(-45, 45, 0.2)), np.radians(np.arange(-10, 11, 2)))
        azimuth, altitude = azimuth.ravel(), altitude.ravel()
        x = self.depth_along(azimuth)
        y = x * np.tan(azimuth)
        return np.stack([x, y, np.hypot(x, y) * np.tan(altitude)], axis=1).astype(np.float32)


def sample(rig, index=0, clouds=None, scans=None, images=None, boxes=None, ego=None):
    """One frame of these messages."""
    messages: dict[str, Message] = {}
    for name, xyz in (clouds or {}).items():
        messages[name] = PointCloud(name, 0, 0, np.asarray(xyz, np.float32))
    for name, (xyz, speed) in (scans or {}).items():
        measured = None if speed is None else np.asarray(speed, np.float32)
        messages[name] = RadarScan(name, 0, 0, np.asarray(xyz, np.float32), measured)
    for name, pixels in (images or {}).items():
        messages[name] = Image(name, 0, 0, pixels.tobytes(), "bgr8", (pixels.shape[1], pixels.shape[0]))
    truth = None if boxes is None else Truth(0, 0, boxes)
    return Sample(Frame(index, 0, 0, messages), rig, truth, ego)


def one_box(x=10.0, y=0.0):
    return Boxes3D(np.array([[x, y, 0.0]]), np.array([[4.0, 2, 2]]), np.zeros(1))


def gray(value=100, size=SIZE):
    return np.full((size[1], size[0], 3), value, np.uint8)


def jpeg(value=100, size=SIZE):
    return encode_jpeg(gray(value, size))
