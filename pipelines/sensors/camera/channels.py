"""Points of LiDARs and radars drawn into an image as two more channels: depth, and radial velocity."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.sensors.bev.stage import BevMeasurement
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_body
from fbench.replay.geometry.kernels import kernel

FOCAL_PX = 320.0
"""Depths are drawn as if the camera had this focal length in the network's input: where a thing is as large."""
NEAREST_M, FARTHEST_M = 1.5, 120.0  # Depths that become 255 and 1 in the channel of depth; 0: nothing
FULL_MPS = 20.0  # Radial velocity that becomes 255; 1 is as fast towards the camera, 128 stands, 0: nothing
NUM_CHANNELS = 2
STANDS_M = (0.25, 4.0)  # What lies between these heights above ground is drawn, and echoes that move
MOVES_MPS = 1.0  # Least radial velocity over ground of those
_REACH_PX = 1  # Beside its pixel a LiDAR point fills so many to each side
_ECHO_M = (0.2, 0.5)  # Half width and half height of what an echo fills, since radars are poor at angles


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """What LiDARs and radars measured, as one camera would see it; without a sensor there are no rows."""

    lidar: Float32  # (N, 3) u, v from the image's upper left corner [px], depth [m]
    radar: Float32  # (M, 4) the same, and radial velocity over ground [m/s], 0 where it isn't known
    focal_px: float

    def move(self, scale: float, corner: Float64) -> "ImagePoints":
        """Return the points as seen in a part of the image from `corner` (2,) [px] on, scaled."""
        place, every = np.asarray(corner, np.float32), (self.lidar, self.radar)
        moved = [np.column_stack([(rows[:, :2] - place) * np.float32(scale), rows[:, 2:]]) for rows in every]
        return ImagePoints(moved[0], moved[1], self.focal_px * scale)

    def mirror(self, width_px: int) -> "ImagePoints":
        """Return the points as seen in the mirrored image."""
        parts = [np.column_stack([np.float32(width_px) - rows[:, 0], rows[:, 1:]]) for rows in (self.lidar, self.radar)]
        return ImagePoints(parts[0], parts[1], self.focal_px)


NO_POINTS = ImagePoints(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), 1.0)


def project_points(rig: Rig, camera: str, seen: BevMeasurement, plane: Plane) -> ImagePoints:
    """Project what LiDARs and radars measured in one frame and stands on the ground, or moves, into a camera. `plane`
    is the ground, which earlier frames showed where this one doesn't. Raises LogError where the camera has no
    projection.
    """
    lidar, radar = np.zeros((0, 3)), np.zeros((0, 4))
    if seen.xyz is not None:
        height = seen.height_m if seen.plane is not None else seen.xyz[:, 2] - plane.z_m(seen.xyz)
        lidar = seen.xyz[(height > STANDS_M[0]) & (height < STANDS_M[1])]
    if seen.echoes is not None:
        rate = np.nan_to_num(seen.echoes.range_rate_mps)
        height = seen.echoes.xyz[:, 2] - plane.z_m(seen.echoes.xyz)
        drawn = ((height > STANDS_M[0]) & (height < STANDS_M[1])) | (np.abs(rate) >= MOVES_MPS)
        radar = np.column_stack([seen.echoes.xyz, rate])[drawn]
    parts = []
    for rows in (lidar, radar):
        uv, depth = project_body(rig, camera, rows[:, :3])
        # What is far beside the image is never drawn.
        kept = (np.abs(np.nan_to_num(uv, nan=1e9)) < 1e5).all(axis=1) & (depth > NEAREST_M / 2) & (depth < FARTHEST_M)
        parts.append(np.column_stack([uv + 0.5, depth, rows[:, 3:]])[kept].astype(np.float32))
    return ImagePoints(parts[0], parts[1], float(rig.cameras[camera].K[1, 1]))


@kernel
def _fill(lidar: Float32, radar: Float32, zoom: float, nearest: Float32, rate: Float32, of_echoes: Float32) -> None:
    """Of several points in one pixel the nearest is drawn, the first of equally near ones."""
    height, width = nearest.shape
    for i in range(len(radar)):
        u, v, depth = radar[i, 0], radar[i, 1], radar[i, 2] / zoom
        aside, above = max(1.0, FOCAL_PX * _ECHO_M[0] / depth), max(1.0, FOCAL_PX * _ECHO_M[1] / depth)
        left, right = max(0, int(np.floor(u - aside))), min(width, int(np.floor(u + aside)) + 1)
        top, bottom = max(0, int(np.floor(v - above))), min(height, int(np.floor(v + above)) + 1)
        for y in range(top, bottom):
            for x in range(left, right):
                if depth < of_echoes[y, x]:
                    of_echoes[y, x] = depth
                    rate[y, x] = radar[i, 3]
    for i in range(len(lidar)):
        column, row, depth = int(np.floor(lidar[i, 0])), int(np.floor(lidar[i, 1])), lidar[i, 2] / zoom
        for y in range(max(0, row - _REACH_PX), min(height, row + _REACH_PX + 1)):
            for x in range(max(0, column - _REACH_PX), min(width, column + _REACH_PX + 1)):
                nearest[y, x] = min(nearest[y, x], depth)


def draw_channels(points: ImagePoints, size_wh: tuple[int, int]) -> Pixels:
    """Draw points into two channels (H, W, 2) of an image.

    Depth, as `FOCAL_PX` says: 255 at `NEAREST_M`, 1 at `FARTHEST_M`, falling with its logarithm; by LiDAR where it
    measured, else by radar.
    Radial velocity of the nearest echo: 128 stands, more recedes, up to `FULL_MPS`. Both 0 where nothing was measured.
    """
    shape = size_wh[1], size_wh[0]
    nearest, of_echoes = np.full(shape, np.inf, np.float32), np.full(shape, np.inf, np.float32)
    rate = np.zeros(shape, np.float32)
    _fill(points.lidar, points.radar, points.focal_px / FOCAL_PX, nearest, rate, of_echoes)
    image = np.zeros((*shape, NUM_CHANNELS), np.uint8)
    has_echo = np.isfinite(of_echoes)
    depth = np.where(np.isfinite(nearest), nearest, of_echoes)
    known = np.isfinite(depth)
    share = np.log(depth[known] / np.float32(NEAREST_M)) / np.float32(np.log(FARTHEST_M / NEAREST_M))
    image[known, 0] = np.rint(255 - 254 * np.clip(share, 0, 1))
    image[has_echo, 1] = np.rint(128 + 127 * np.clip(rate[has_echo] / np.float32(FULL_MPS), -1, 1))
    return image
