"""Comparison of LiDARs with cameras: whether edges fit, and depth by stereo."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel
from fbench.replay.geometry.camera import in_image, project
from fbench.replay.geometry.stereo_pairs import Pair, Rectified
from fbench.replay.geometry.transforms import inverse, transform
from fbench.reports.preview import draw
from fbench.reports.preview.camera import whole
from fbench.reports.preview.draw import INK, of_depth
from fbench.reports.preview.sample import Sample, edge_strength, sample_image

WIDTH_PX = 640
STEP_DEG = 0.5
REACH_DEG = 4.0
MIN_EDGES = 60  # With fewer edges of depth in all images nothing is said
MIN_GAIN = 0.06
MIN_SUPPORT, MIN_STRIPES = 0.6, 8
_STRIPES, _STRIPE_EDGES = 12, 5
_MAX_EDGES = 600  # Of one frame; more tell nothing new
MIN_SCORE = 1.15
_NEAREST_M = 2.5
_MAX_DISPARITY = 256
_BLOCK = 9
_COMPARED_M = (3.0, 40.0)
_MIN_COMPARED = 50


@dataclass(frozen=True)
class Alignment:
    """What turning LiDAR edges about the axes of a camera (x right, y down, z forward) gives."""

    camera: str
    num_edges: int
    turn_deg: tuple[float, float, float]  # The rotation vector that fits best, in steps of half a degree
    score: float  # Mean strength of image edges under LiDAR edges, as calibrated; the mean of the image is 1
    best_score: float
    support: float  # Share of the stripes of images in which that turn is better than the calibration
    num_stripes: int  # Upright stripes of images with enough edges, of all frames together

    @property
    def is_off(self) -> bool:
        """Whether another rotation is clearly better."""
        gain = self.best_score - self.score
        angle = float(np.sqrt(np.sum(np.square(self.turn_deg))))
        clear = self.support >= MIN_SUPPORT and self.num_stripes >= MIN_STRIPES
        return clear and not self.is_unclear and angle >= 1.0 and gain > MIN_GAIN * self.best_score

    @property
    def is_unclear(self) -> bool:
        """Whether the best turn is at the border of the search, as where all edges are on one object."""
        return max(abs(turn) for turn in self.turn_deg) >= REACH_DEG

    @property
    def is_lost(self) -> bool:
        """Whether edges of LiDAR and image have nothing to do with each other, and no turn mends it."""
        return self.num_stripes >= MIN_STRIPES and self.score < MIN_SCORE and not self.is_off

    @property
    def is_bad(self) -> bool:
        """Whether the calibration deserves a look."""
        return self.is_off or self.is_lost

    @property
    def verdict(self) -> str:
        """One line about it."""
        if self.num_edges < MIN_EDGES:
            return f"too few LiDAR edges in the image to judge ({self.num_edges})"
        if self.is_lost:
            chance = f"score {self.score:.2f}, 1 is chance"
            return f"LiDAR edges don't fit the image, turned by up to 4 deg either ({chance})"
        if self.is_unclear:
            return f"can't be judged: too few objects with edges at different places (score {self.score:.2f})"
        if not self.is_off:
            return f"LiDAR edges fit the image as calibrated ({self.num_edges} edges, score {self.score:.2f})"
        most = max(abs(turn) for turn in self.turn_deg)
        large = [(t, name) for t, name in zip(self.turn_deg, "xyz", strict=True) if abs(t) >= min(1.0, most)]
        turns = [f"{t:+.1f} deg about the camera's {name} axis" for t, name in large]
        scores = f"score {self.score:.2f} → {self.best_score:.2f}, {self.num_edges} edges"
        return f"LiDAR edges fit the image better when turned by {' and '.join(turns)} ({scores})"


class _Evidence(NamedTuple):
    """One image and the edges of the sweeps that go with it."""

    field: Float32
    edges: Float64  # (N, 3) in camera coordinates [m]


def align(samples: Sequence[Sample], camera: str) -> Alignment:
    """Compare the calibrated rotation with others up to 4 degrees away.

    The score is the mean strength of image edges where edges of depth are projected to: largest where both coincide
    (Levinson and Thrun 2013). One axis after the other is searched, twice.
    """
    evidence = [found for sample in samples if (found := _evidence(sample, camera)) is not None]
    num = sum(len(found.edges) for found in evidence)
    model = next((s.rig.cameras[camera] for s in samples if camera in s.rig.cameras), None)
    if num < MIN_EDGES or model is None:
        return Alignment(camera, num, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0)
    turn = _best(evidence, model)
    here = [_values(found, model, np.zeros(3)) for found in evidence]
    there = [_values(found, model, turn) for found in evidence]
    gains: list[float] = []  # In each upright stripe of an image that has edges: one object alone proves little
    for own, a, b in zip(evidence, here, there, strict=True):
        uv, _ = project(model, own.edges)
        stripe = np.floor(np.clip(uv[:, 0] / model.size_wh[0], 0, 0.999) * _STRIPES).astype(np.int64)
        wanted = [rows for number in range(_STRIPES) if (rows := stripe == number).sum() >= _STRIPE_EDGES]
        gains += [float(np.mean(b[rows]) - np.mean(a[rows])) for rows in wanted]
    x, y, z = (round(float(value), 3) + 0.0 for value in turn)
    score, best = (float(np.mean(np.concatenate(values))) for values in (here, there))
    support = float(np.mean([gain > 0 for gain in gains])) if gains else 0.0
    return Alignment(camera, num, (x, y, z), score, best, support, len(gains))


def edges_of(sample: Sample, camera: str) -> Float64:
    """Edges of depth (N, 3) [m] of all placed LiDARs, in coordinates of a camera."""
    return transform(inverse(sample.rig.body_T_sensor(camera)), sample.depth_edges_m)


def _evidence(sample: Sample, camera: str) -> _Evidence | None:
    if camera not in sample.cameras or camera not in sample.rig.cameras:
        return None
    edges = edges_of(sample, camera)
    uv, _ = project(sample.rig.cameras[camera], edges)
    edges = edges[in_image(sample.rig.cameras[camera], uv)]
    edges = edges[:: max(1, -(-len(edges) // _MAX_EDGES))]
    if not len(edges):
        return None
    field = edge_strength(sample.image(camera), WIDTH_PX)
    mean = max(float(field.mean(dtype=np.float64)), 1e-6)
    return _Evidence((field / np.float32(mean)).astype(np.float32), edges)


def _best(evidence: Sequence[_Evidence], model: CameraModel) -> Float64:
    """Rotation vector [deg] with the highest score; of equal ones the one that turns least."""
    turn = np.zeros(3)
    steps = np.arange(-REACH_DEG, REACH_DEG + STEP_DEG / 2, STEP_DEG)
    for axis in (1, 0, 2, 1, 0, 2):
        candidates = [np.where(np.arange(3) == axis, step, turn) for step in sorted(steps, key=abs)]
        scores = [float(np.mean(np.concatenate([_values(e, model, c) for e in evidence]))) for c in candidates]
        turn = candidates[int(np.argmax(scores))]
    return turn


def _values(found: _Evidence, model: CameraModel, turn_deg: Float64) -> Float64:
    """Strength (N,) of the image at LiDAR edges that are turned by a rotation vector [deg] in camera coordinates."""
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    uv, _ = project(model, transform(turned, found.edges))
    return sample_image(found.field, (uv + 0.5) * (WIDTH_PX / model.size_wh[0]) - 0.5)


def edges_view(sample: Sample, camera: str) -> Pixels:
    """Draw the upright edges of the image in gray and the near sides of jumps in depth upon them, by depth."""
    pixels, model = sample.image(camera), sample.rig.cameras[camera]
    window = whole(model.size_wh)
    width, height = window.size_wh
    strength = edge_strength(pixels, width)
    gray = np.round(255 * np.clip(strength / max(float(strength.max()), 1e-6), 0, 1)).astype(np.uint8)
    picture = draw.canvas(width, height)
    rows = min(height, gray.shape[0])
    picture[:rows] = np.repeat(gray[:rows, :, None], 3, axis=2)
    uv, depth = project(model, edges_of(sample, camera))
    seen = in_image(model, uv)
    radii = np.full(int(seen.sum()), 3 if seen.sum() < 1500 else 2)
    draw.disks(picture, window.to_picture(uv[seen]), radii, of_depth(depth[seen]))
    text = f"frame {sample.frame.index}: jumps of LiDAR depth on upright edges of {draw.plain(camera)}"
    draw.lines(picture, [text], [INK])
    return picture


@dataclass(frozen=True, eq=False)
class StereoView:
    """One frame of a pair."""

    picture: Pixels
    found_share: float  # Share of pixels to which a depth was found
    num_compared: int  # LiDAR points in 3 to 40 m at whose pixel stereo has a depth
    median_error: float | None  # Median of |stereo - LiDAR| / LiDAR; `None` with too few points
    median_bias: float | None  # Median of (stereo - LiDAR) / LiDAR

    @property
    def caption(self) -> str:
        """What is seen, in a line."""
        found = f"depth for {self.found_share:.0%} of the pixels"
        if self.median_error is None or self.median_bias is None:
            return f"{found}; no comparison with a LiDAR ({self.num_compared} points in common)"
        error = f"{self.median_error:.1%} (bias {self.median_bias:+.1%}, {self.num_compared} points)"
        return f"{found}; median relative difference from LiDAR {error}"


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
    return StereoView(picture, float(np.mean(disparity > 0)), len(error), off, bias)


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
