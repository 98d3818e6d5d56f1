"""Depth and points by stereo, beside those of LiDARs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.scores import format_count
from fbench.replay.geometry.camera import in_image, project
from fbench.replay.geometry.stereo_pairs import Pair, Rectified, rectify
from fbench.replay.geometry.transforms import inverse, transform
from fbench.reports.preview import draw
from fbench.reports.preview.camera import whole
from fbench.reports.preview.draw import INK, of_depth, of_height
from fbench.reports.preview.sample import Sample
from fbench.reports.preview.views import Ground, draw_rings, write_rings

_NEAREST_M = 2.5
_MAX_DISPARITY = 256
_BLOCK = 9
_COMPARED_M = (3.0, 40.0)
_MIN_COMPARED = 50
_CLOUD = Ground((0.0, -20.0), (40.0, 20.0), 16.0)  # The part of the ground where clouds are compared
_EVERY_PX = 3  # Of the pixels, in both directions, one becomes a point
_HEIGHTS_M = (-0.5, 3.5)  # Above the body's origin, from which to which colors go


@dataclass(frozen=True, eq=False)
class StereoView:
    """One frame of a pair."""

    picture: Pixels
    cloud: Pixels  # LiDAR on the left, points by stereo on the right, both from above (thesis, figure 5.13)
    found_share: float  # Share of pixels to which a depth was found
    num_compared: int  # LiDAR points in 3 to 40 m at whose pixel stereo has a depth
    median_error: float | None  # Median of |stereo - LiDAR| / LiDAR; `None` with too few points
    median_bias: float | None  # Median of (stereo - LiDAR) / LiDAR

    @property
    def caption(self) -> str:
        """What is seen, in a line."""
        found = f"depth for {self.found_share:.0%} of the pixels"
        if self.median_error is None or self.median_bias is None:
            return f"{found}; no comparison with a LiDAR ({format_count(self.num_compared, 'point')} in common)"
        error = f"{self.median_error:.1%} (bias {self.median_bias:+.1%}, {format_count(self.num_compared, 'point')})"
        return f"{found}; median relative difference from LiDAR {error}"


def rectify_each(samples: Sequence[Sample], pair: Pair) -> list[Rectified]:
    """Rectify a pair as each sample was measured, anew only where the calibration has changed."""
    found: list[Rectified] = []
    for i, sample in enumerate(samples):
        is_same = i > 0 and sample.rig is samples[i - 1].rig
        found.append(found[-1] if is_same else rectify(sample.rig, pair))
    return found


def stereo_view(sample: Sample, pair: Pair, how: Rectified) -> StereoView:
    """Rectify, match and color one frame; the LiDAR is drawn into the rectified image beside it."""
    left, right = how.images(sample.image(pair.left), sample.image(pair.right))
    disparity = _disparity(left, right, how)
    depth = np.where(disparity > 0, how.camera.K[0, 0] * how.baseline_m / np.maximum(disparity, 0.1), np.nan)
    # LiDAR points in the rectified left image, the farthest first.
    xyz = np.concatenate([np.zeros((0, 3)), *(points.xyz for points in sample.points_of("lidar"))])
    left_T_body = inverse(sample.rig.body_T_sensor(pair.left))
    uv, lidar_m = project(how.camera, transform(how.rectified_T_left, transform(left_T_body, xyz)))
    rows = np.flatnonzero(in_image(how.camera, uv))
    rows = rows[np.argsort(-lidar_m[rows], kind="stable")]
    width, height = how.size_wh
    uv, lidar_m = np.clip(uv[rows], 0, [width - 1, height - 1]), lidar_m[rows]
    at = np.round(uv).astype(np.int64)
    stereo_m = depth[at[:, 1], at[:, 0]]
    both = np.isfinite(stereo_m) & (lidar_m > _COMPARED_M[0]) & (lidar_m < _COMPARED_M[1])
    error = (stereo_m[both] - lidar_m[both]) / lidar_m[both]
    enough = len(error) >= _MIN_COMPARED
    off = float(np.median(np.abs(error))) if enough else None
    bias = float(np.median(error)) if enough else None
    picture = _draw_depths(left, depth, uv, lidar_m, pair)
    cloud = _draw_clouds(xyz, _points(depth, how, sample.rig.body_T_sensor(pair.left)), pair)
    return StereoView(picture, cloud, float(np.mean(disparity > 0)), len(error), off, bias)


def _points(depth: Float64, how: Rectified, body_T_left: Float64) -> Float64:
    """Points (N, 3) [m] of a depth image (H, W) in body coordinates: X = (u - c_x) Z / f, Y = (v - c_y) Z / f."""
    v, u = np.indices(depth.shape)[:, ::_EVERY_PX, ::_EVERY_PX]
    z = depth[::_EVERY_PX, ::_EVERY_PX]
    kept = np.isfinite(z)
    K = how.camera.K
    at = [(u[kept] - K[0, 2]) * z[kept] / K[0, 0], (v[kept] - K[1, 2]) * z[kept] / K[1, 1], z[kept]]
    return transform(body_T_left, transform(inverse(how.rectified_T_left), np.stack(at, axis=1)))


def _draw_clouds(lidar: Float64, stereo: Float64, pair: Pair) -> Pixels:
    """Both clouds from above side by side, colored by height; the highest points are drawn last."""
    halves = []
    for xyz, text in ((lidar, "LiDAR"), (stereo, f"stereo of {draw.plain(pair.left)} and {draw.plain(pair.right)}")):
        half = draw.canvas(*_CLOUD.size_wh)
        rings = draw_rings(half, _CLOUD)
        own = xyz[np.argsort(xyz[:, 2], kind="stable")]
        draw.disks(half, _CLOUD.to_picture(own[:, :2]), np.ones(len(own)), of_height(own[:, 2], *_HEIGHTS_M))
        write_rings(half, rings)
        draw.lines(half, [f"{text}: {format_count(len(xyz), 'point')}, from above, by height"], [INK])
        halves.append(half)
    return np.concatenate([halves[0], np.full((len(halves[0]), 4, 3), 255, np.uint8), halves[1]], axis=1)


def _disparity(left: Pixels, right: Pixels, how: Rectified) -> Float32:
    """Disparity (H, W) [px] by semi-global matching; 0 or less where none was found."""
    import cv2

    most = how.camera.K[0, 0] * how.baseline_m / _NEAREST_M
    widest = min(_MAX_DISPARITY, left.shape[1] // 32 * 16)  # OpenCV fails where it isn't less than the image's width
    num = int(min(widest, max(16, -(-most // 16) * 16)))
    penalty = _BLOCK * _BLOCK
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=num, blockSize=_BLOCK, P1=8 * penalty, P2=32 * penalty, disp12MaxDiff=1,
        preFilterCap=63, uniquenessRatio=15, speckleWindowSize=200, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    gray = [np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8) for pixels in (left, right)]
    return np.asarray(matcher.compute(*gray), np.float32) / np.float32(16)


def _draw_depths(left: Pixels, depth: Float64, uv: Float64, lidar_m: Float64, pair: Pair) -> Pixels:
    """Rectified image with LiDAR on the left, depth by stereo on the right, both in the same colors."""
    colors = of_depth(depth.reshape(-1)).reshape(*depth.shape, 3)
    colors[np.isnan(depth)] = 0
    window = whole((left.shape[1] * 2, left.shape[0]))
    both = window.picture(np.concatenate([left, colors], axis=1))
    radii = np.full(len(uv), 2 if len(uv) < 6000 else 1)
    draw.disks(both, window.to_picture(uv), radii, of_depth(lidar_m))
    draw.lines(both, [f"{draw.plain(pair.left)} rectified, LiDAR by depth"], [INK])
    draw.lines(both, [f"stereo depth with {draw.plain(pair.right)}"], [INK], (both.shape[1] // 2 + 10, 20))
    return both
