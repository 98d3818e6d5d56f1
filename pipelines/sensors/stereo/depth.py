"""Depth by stereo: rectification, disparity by semi-global matching, its quality, and points in body coordinates."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Float32, Float64, Int64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import is_pinhole, require_projection
from fbench.replay.geometry.kernels import kernel
from fbench.replay.geometry.stereo_pairs import MAX_ANGLE_DEG, Pair, Rectified, pairs, rectify
from fbench.replay.geometry.transforms import inverse

_STRAIGHT_PX = 0.05  # Rows that differ by less than this count as the same: images were rectified before


def choose_pair(rig: Rig, log_name: str, left: str | None, right: str | None) -> Pair:
    """Return the pair with the longest baseline, the first by name of equally long ones, or of those named. Raises
    ConfigError where a name isn't that of a camera. Raises LogError where the rig has no such pair, or a camera of it
    can't be projected into.
    """
    cameras = rig.sensors("camera")
    for side, name in (("left", left), ("right", right)):
        if name is not None and name not in cameras:
            raise ConfigError(f"stereo.{side}={name}: no such camera{did_you_mean(name, cameras)}")
    fitting = [p for p in pairs(rig) if left in (None, p.left) and right in (None, p.right)]
    if not fitting:
        wanted = (
            f"a stereo pair needs two cameras of one size with calibration, parallel within {MAX_ANGLE_DEG:g} degrees, "
            "0.05 to 2 m side by side"
        )
        if left is not None or right is not None:
            wanted += f" (stereo.left={left or 'any'}, stereo.right={right or 'any'})"
        sizes = {name: "{}x{}".format(*camera.size_wh) for name, camera in rig.cameras.items()}
        present = ", ".join(f"{name} {sizes[name]}" if name in sizes else name for name in cameras) or "no cameras"
        raise LogError(f"log '{log_name}': {wanted}; the log has: {present}", "CFG001")
    pair = min(fitting, key=lambda p: (-round(p.baseline_m, 6), p.left, p.right))
    for name in (pair.left, pair.right):
        require_projection(rig, name)
    return pair


@dataclass(frozen=True, eq=False)
class Rectifier:
    """Makes grey rectified images of one size from those of a pair, with maps that are computed once."""

    pair: Pair
    camera: CameraModel  # The left camera, shrunk and rectified; the right one is the same, `baseline_m` to its right
    baseline_m: float
    body_T_camera: Float64  # (4, 4) pose of the rectified left camera in body coordinates
    maps: Rectified | None  # How shrunk images are rectified; `None` where they are already

    def images(self, left: Pixels, right: Pixels) -> tuple[Pixels, Pixels]:
        """Shrink and rectify two grey images (H, W), to (h, w)."""
        size = self.camera.size_wh
        one, other = (
            image if image.shape[::-1] == size else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
            for image in (left, right)
        )
        return (one, other) if self.maps is None else self.maps.images(one, other)


def rectifier(rig: Rig, pair: Pair, shrink: int) -> Rectifier:
    """Compute how a pair is shrunk and rectified. Raises LogError for an unknown lens, or images too small to match."""
    cameras = {}
    for name in (pair.left, pair.right):  # pixel centers stay at integers
        camera, K = rig.cameras[name], rig.cameras[name].K.copy()
        width, height = (max(side // shrink, 1) for side in camera.size_wh)
        ratio = np.array([width, height]) / np.array(camera.size_wh)
        K[:2] *= ratio[:, None]
        K[:2, 2] += 0.5 * ratio - 0.5
        cameras[name] = CameraModel(K, (width, height), camera.distortion_model, camera.distortion)
    small = Rig(rig.mounts, cameras)
    how = rectify(small, pair)
    body_T_left = rig.body_T_sensor(pair.left)
    if _is_straight(small, pair):
        return Rectifier(pair, small.cameras[pair.left], pair.baseline_m, body_T_left, None)
    return Rectifier(pair, how.camera, how.baseline_m, body_T_left @ inverse(how.rectified_T_left), how)


def _is_straight(rig: Rig, pair: Pair) -> bool:
    """Tell whether both cameras have the same `K`, no lens, parallel axes, and only x between them."""
    left, right = rig.cameras[pair.left], rig.cameras[pair.right]
    if not (is_pinhole(left) and is_pinhole(right)) or np.abs(left.K - right.K).max() > _STRAIGHT_PX:
        return False
    left_T_right = inverse(rig.body_T_sensor(pair.left)) @ rig.body_T_sensor(pair.right)
    turned = float(np.abs(left_T_right[:3, :3] - np.eye(3)).max())
    aside = float(np.abs(left_T_right[1:3, 3]).max()) / pair.baseline_m
    # Turned by an angle a, pixels move by about a times the distance to the corners; aside, by the share of disparity.
    reach = float(np.hypot(*left.size_wh)) + float(left.K[0, 0])
    return turned * reach < _STRAIGHT_PX and aside * left.size_wh[0] / 8 < _STRAIGHT_PX


@kernel
def gather(
    disparity: Float32, focal_baseline: float, per_px: Float64, body_T_camera: Float64, depth_m: Float64,
    bins: Float64, z_m: Float64,
) -> tuple[Float64, Int64]:  # fmt: skip
    """Mean points (M, 3) [m] in body coordinates of cells, and their numbers of pixels (M,).

    Takes disparities (W, H) [px], column by column, NaN where unknown; f B [px m]; 1/f and -c/f of x and y (2, 2);
    the least and largest depth [m]; edges of cells: columns [px], disparity [px], height [m]; the least and largest
    height [m]. Cells come in the order of their columns, then of their first pixel. Z = f B / d, X = (u - c) Z / f.
    """
    width, height = disparity.shape
    num_u = int(bins[0])
    num_d = int(focal_baseline / depth_m[0] / bins[1]) + 2
    num_z = int((z_m[1] - z_m[0]) / bins[2]) + 1
    known = np.full(num_d * num_z, -1, np.int64)
    sums, counts = np.zeros((4096, 3)), np.zeros(4096, np.int64)
    touched = np.zeros(min(num_u * height, len(known)), np.int64)
    num = 0
    R, t = body_T_camera[:3, :3], body_T_camera[:3, 3]
    for first in range(0, width, num_u):
        num_touched = 0
        for u in range(first, min(first + num_u, width)):
            a = u * per_px[0, 0] + per_px[0, 1]
            for v in range(height):
                d = disparity[u, v]
                if not d * depth_m[1] >= focal_baseline or d * depth_m[0] > focal_baseline:
                    continue
                depth = focal_baseline / d
                b = v * per_px[1, 0] + per_px[1, 1]
                z = (R[2, 0] * a + R[2, 1] * b + R[2, 2]) * depth + t[2]
                if not z_m[0] <= z < z_m[1]:
                    continue
                at = int(d / bins[1]) * num_z + int((z - z_m[0]) / bins[2])
                cell = known[at]
                if cell < 0:
                    if num == len(counts):
                        sums = np.concatenate((sums, np.zeros_like(sums)))
                        counts = np.concatenate((counts, np.zeros_like(counts)))
                    cell = known[at] = num
                    touched[num_touched] = at
                    num_touched += 1
                    num += 1
                counts[cell] += 1
                sums[cell, 0] += (R[0, 0] * a + R[0, 1] * b + R[0, 2]) * depth + t[0]
                sums[cell, 1] += (R[1, 0] * a + R[1, 1] * b + R[1, 2]) * depth + t[1]
                sums[cell, 2] += z
        known[touched[:num_touched]] = -1
    return sums[:num] / counts[:num].reshape(-1, 1), counts[:num]


HEIGHT_M = 6.0  # Points farther above or below the camera [m] are left out


@dataclass(frozen=True)
class DepthParams(CheckedParams, prefix="stereo.depth"):
    """Pixels become points; those of one cell of columns, disparity and height become one, their mean. Cells grow with
    depth as its error does, so that each holds about as much noise: dZ = Z^2 / (f B) dd.
    """

    max_range_m: float = in_range(40.0, 1, 500)  # Farther depths [m] are left out, the sky with them.
    cell_px: int = in_range(4, 1, 100)  # Columns of a cell [px] of the shrunk image.
    cell_disparity_px: float = in_range(0.5, 0.05, 100)  # Its range of disparities [px].
    cell_height_m: float = in_range(0.25, 0.05, 10)  # Its height [m].
    min_pixels: int = in_range(8, 1, 10_000)  # Cells with fewer pixels are noise.


def points(disparity: Float32, how: Rectifier, nearest_m: float, params: DepthParams) -> Float64:
    """Points (N, 3) [m] in body coordinates, in lexicographic order. Takes disparities (H, W) [px] of the rectified
    left image, NaN where unknown; nearer depths are left out, too.
    """
    K, t = how.camera.K, how.body_T_camera[:3, 3]
    per_px = np.array([[1 / K[0, 0], -K[0, 2] / K[0, 0]], [1 / K[1, 1], -K[1, 2] / K[1, 1]]])
    limits = np.array([min(nearest_m, params.max_range_m), params.max_range_m])
    cells = np.array([params.cell_px, params.cell_disparity_px, params.cell_height_m])
    z_m = np.array([t[2] - HEIGHT_M, t[2] + HEIGHT_M])
    columns = np.ascontiguousarray(disparity.T)
    xyz, num = gather(columns, K[0, 0] * how.baseline_m, per_px, how.body_T_camera, limits, cells, z_m)
    xyz = xyz[num >= params.min_pixels]
    return xyz[np.lexsort(xyz.T[::-1])]


_STEP = 16  # OpenCV searches a multiple of so many disparities, and gives them in units of 1/16 px


@dataclass(frozen=True)
class DisparityParams(CheckedParams, prefix="stereo.disparity"):
    """Semi-global block matching (Hirschmueller, PAMI 2008); all pixels are those of the shrunk images."""

    shrink: int = in_range(2, 1, 8)
    """Images are made smaller by this factor before they are matched: 2 is about four times as fast as 1, and depth is
    half as exact.
    """
    nearest_m: float = in_range(3.0, 0.1, 100)
    """Nearer things [m] aren't found: the disparities that are searched end at f B / nearest_m."""
    max_disparity_px: int = in_range(192, 16, 1024)
    """No larger disparities [px] are searched, however near `nearest_m` is."""
    block_px: int = in_range(5, 1, 31)  # Edge of the blocks that are compared [px], odd.
    smoothness: tuple[int, int] = (8, 32)
    """Penalty on a step of one disparity, and on a larger one, in grey levels for each pixel of a block."""
    uniqueness: int = in_range(10, 0, 100)  # By how much [%] the best match must be better than the second.
    left_right_px: int = in_range(1, 0, 100)  # By how much [px] matching from the right image may differ.
    speckle_px: int = in_range(60, 0, 10_000)  # Patches of like disparity with fewer pixels are dropped.
    texture: float = in_range(1.0, 0, 255)
    """Mean step between horizontal neighbors [grey levels] in a block twice as wide: flatter places, such as the sky,
    can't be matched.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        one, more = self.smoothness
        if self.block_px % 2 == 0:
            raise ConfigError(f"stereo.disparity.block_px: expected an odd number, got {self.block_px}")
        if not 0 < one < more <= 1000:
            raise ConfigError(f"stereo.disparity.smoothness: expected 0 < first < second <= 1000, got {one},{more}")


class Matcher:
    """Matches pairs of rectified images of one size; disparities below `num_px` are searched."""

    def __init__(self, focal_px: float, baseline_m: float, width_px: int, params: DisparityParams) -> None:
        most = min(focal_px * baseline_m / params.nearest_m, params.max_disparity_px)
        # OpenCV fails where it isn't less than the width, which the margin doubles at most.
        self.num_px = max(1, min(math.ceil(most / _STEP), width_px // _STEP)) * _STEP
        one, more = (level * params.block_px**2 for level in params.smoothness)
        self._block, self._texture = params.block_px, params.texture
        self._sgbm = cv2.StereoSGBM.create(
            minDisparity=0, numDisparities=self.num_px, blockSize=params.block_px, P1=one, P2=more,
            disp12MaxDiff=params.left_right_px, preFilterCap=31, uniquenessRatio=params.uniqueness,
            speckleWindowSize=params.speckle_px, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )  # fmt: skip

    def disparity(self, left: Pixels, right: Pixels, texture: Float32) -> Float32:
        """Match grey images (H, W), the left one with its `texture`; NaN where nothing fits.

        Returns d = u_left - u_right (H, W) [px]. Both images get a margin on the left, because OpenCV doesn't look at
        pixels nearer to that border than the largest disparity; matches in it don't count.
        """
        wide = [cv2.copyMakeBorder(one, 0, 0, self.num_px, 0, cv2.BORDER_REPLICATE) for one in (left, right)]
        found = np.asarray(self._sgbm.compute(wide[0], wide[1])[:, self.num_px :], np.float32)
        disparity: Float32 = found / np.float32(_STEP)
        column = np.arange(left.shape[1], dtype=np.float32)
        disparity[(disparity <= 0) | (disparity > column) | (texture < self._texture)] = np.nan
        return disparity

    def texture(self, image: Pixels) -> Float32:
        """Mean absolute step to the right (H, W) [grey levels] around each pixel of a grey image."""
        step = np.zeros(image.shape, np.uint8)
        cv2.absdiff(image[:, 1:], image[:, :-1], step[:, :-1])
        size = (2 * self._block + 1, self._block)
        return np.asarray(cv2.boxFilter(step, cv2.CV_32F, size, borderType=cv2.BORDER_REPLICATE), np.float32)


_BELOW_HORIZON = 0.025
"""The ground begins this share of the image's height below the horizon: farther ground has hardly any disparity."""
_QUALITY_HEIGHT_M = (0.3, 4.0)  # Cameras of vehicles are this high above the ground


@dataclass(frozen=True)
class QualityParams(CheckedParams, prefix="stereo.quality"):
    """When depth is taken for noise: in rain and by night images differ by more than their texture, fog takes it."""

    min_share: float = in_range(0.62, 0, 1)
    """Share of the pixels below the horizon that need a sure match [0 to 1]; with fewer, stereo is left out."""
    texture: float = in_range(1.2, 0, 255)
    """Sure matches have at least this texture [grey levels], see `disparity.texture`."""
    mismatch: float = in_range(0.8, 0, 1000)
    """Mean difference of the matched pixels around them, as a multiple of the texture: at most this. Divided by the
    texture, a difference in brightness is about the error of disparity [px] that it causes.
    """


def last_row(disparity: Float32, how: Rectifier, most_px: float) -> int:
    """Return the row [px] below which the ground is too near to be matched, the height of the image where none is.

    Takes disparities (H, W) [px] of up to `most_px`. On a level road a pixel v below the horizon has d = v B / h, with
    h the camera's height above the road; h is the median over the image.
    """
    height = len(disparity)
    first = _first_row(how, height)
    if first >= height:
        return height
    below = np.arange(first, height) - how.camera.K[1, 2]
    with np.errstate(invalid="ignore"):
        over_ground = (below * how.baseline_m)[:, None] * (how.camera.K[0, 0] / how.camera.K[1, 1]) / disparity[first:]
    known = over_ground[np.isfinite(over_ground)]
    if not len(known):
        return height
    camera_m = float(np.clip(np.median(known), *_QUALITY_HEIGHT_M))
    scale = how.baseline_m * how.camera.K[0, 0] / how.camera.K[1, 1] / camera_m
    return int(np.clip(how.camera.K[1, 2] + 0.95 * most_px / scale, first, height))


def sure_share(
    left: Pixels, right: Pixels, disparity: Float32, texture: Float32, how: Rectifier, end: int, params: QualityParams
) -> float:
    """Share [0 to 1] of the pixels from the horizon down to row `end` whose match is sure; 0 where none is there. Takes
    rectified grey images, disparity and texture of the left one, all (H, W).
    """
    begin = _first_row(how, len(left))
    if begin >= end:
        return 0.0
    rows = slice(begin, end)
    found = disparity[rows]
    known = np.isfinite(found)
    v, u = np.indices(found.shape, np.float32)
    matched = cv2.remap(right[rows], u - np.where(known, found, np.float32(0)), v, cv2.INTER_LINEAR)
    difference = cv2.boxFilter(cv2.absdiff(left[rows], matched), cv2.CV_32F, (11, 5), borderType=cv2.BORDER_REPLICATE)
    flat = texture[rows]
    sure = known & (flat >= params.texture) & (difference <= params.mismatch * flat)
    return float(np.mean(sure))


def _first_row(how: Rectifier, height: int) -> int:
    return max(0, int(np.ceil(how.camera.K[1, 2] + _BELOW_HORIZON * height)))
