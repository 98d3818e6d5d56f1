"""How far away is what an image shows: from LiDAR where there is a cloud, else by a flat ground."""

from functools import lru_cache

import cv2
import numpy as np

from fbench.replay.contracts.conditions import Site
from fbench.replay.data.arrays import Array, Bool, Float32, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import in_image, not_projectable, project, rays
from fbench.replay.geometry.transforms import chain, inverse, transform

FAR_M = 300.0
"""The sky, and everything farther away."""
_NEAR_M = 0.5
_COLUMNS = 480  # Of the grid, at most
_HEIGHT_M, _HEIGHTS_M = 1.5, (0.3, 5.0)  # Of a camera above the ground, where its mount gives none of these
_FEWEST = 100  # Cells with a LiDAR's points, for them to say anything about an image
_BIN_DEG, _HOLE_DEG, _FADE_DEG = 0.2, 1.25, 1.5
"""Holes in a cloud up to twice so wide are glass or black paint; into wider ones the points around say less and less,
since a LiDAR that looks and gets no echo looks far."""
_SAMPLES, _AROUND_M, _STEPS_M = 3_000, 30.0, (1.0, 0.6, 0.4, 0.3, 0.2)
"""Of so many points the ground is made, within this distance, and how far from it they may be, step by step."""
_BESIDE = 0.02  # Cosine by which points may be outside of the middles of an image's outermost cells
_SKY_CONTRAST, _SKY_SHARE = 6.0, 0.6


def gray_cells(pixels: Pixels) -> Float32:
    """Return the mean of (b + 2 g + r) / 4 in the cells (h, w) of a grid over an image (H, W, 3): squares of whole
    pixels, up to 480 of them side by side.
    """
    width, height = pixels.shape[1::-1]
    cell = max(1, -(-width // _COLUMNS))
    cells = cv2.resize(pixels, (-(-width // cell), -(-height // cell)), interpolation=cv2.INTER_AREA)
    gray: Array = cv2.transform(cells, np.array([[0.25, 0.5, 0.25]], np.float32))
    return np.asarray(gray, np.float32).reshape(cells.shape[:2])


def distances(gray: Float32, size_wh: tuple[int, int], site: Site) -> Float32:
    """Return the distance [m] from the camera of what the cells (h, w) of an image show, at most `FAR_M`; `gray` is how
    bright they are.

    A cloud's points count where they hit, and between; where it looks and gets no echo it is far, up to the ground;
    outside of its view it goes on as within. An even, bright area that reaches down from the image's top is sky.
    Without a cloud in view it is flat ground below the horizon, and far above: d = h f / (v - v0) along the ray.
    """
    directions, camera, cloud = _directions(site.rig, site.sensor, size_wh, gray.shape), _camera(site), site.cloud
    if cloud is None or camera is None or cloud.sensor not in site.rig.mounts:
        return np.reciprocal(_ground(directions, (0.0, 0.0, 0.0), site))
    body_T_lidar = site.rig.body_T_sensor(cloud.sensor)
    body_T_camera = site.rig.body_T_sensor(site.sensor)
    sampled = transform(body_T_lidar, cloud.xyz[:: max(1, len(cloud.xyz) // _SAMPLES)])
    ground = _ground(directions, _fit_ground(sampled), site)
    in_camera = transform(chain(inverse(body_T_camera), body_T_lidar), cloud.xyz)
    x, y, z = in_camera.T
    range_m = np.sqrt(x * x + y * y + z * z)
    with np.errstate(invalid="ignore"):  # points that aren't finite, and rays that a lens doesn't see
        widest = float(np.nanmin(directions @ body_T_camera[:3, 2].astype(np.float32))) - _BESIDE
        near = np.flatnonzero((z > widest * range_m) & (range_m > _NEAR_M))
    uv, _ = project(camera, in_camera[near])
    shown = in_image(camera, uv)
    uv, near = uv[shown], near[shown]
    hits = _nearest(uv, range_m[near], directions.shape[:2], camera.size_wh)
    if np.count_nonzero(hits) < _FEWEST:
        return np.reciprocal(ground)
    x, y, z = cloud.xyz[near].T
    altitude = np.degrees(np.arctan2(z, np.hypot(x, y)))
    low, high = np.quantile(altitude, (0.005, 0.995))
    rise = directions @ body_T_lidar[:3, 2].astype(np.float32)
    known, between = _spread(hits > 0, max(_HOLE_DEG, _spacing(altitude)), directions)
    sky = _sky(gray, directions) & ~between
    inside = (rise >= np.sin(np.radians(low))) & (rise <= np.sin(np.radians(high))) & ~sky
    result = np.maximum(known * _fill(hits) + (1 - known) * ground, 1 / FAR_M)
    if inside.any():
        result = np.where(inside, result, _fill(np.where(inside, result, 0)))
    return np.asarray(1 / np.where(sky, 1 / FAR_M, result), np.float32)


def _camera(site: Site) -> CameraModel | None:
    """The model of a camera into which points can be projected."""
    camera = site.rig.cameras.get(site.sensor)
    return camera if camera and site.sensor in site.rig.mounts and not not_projectable(camera) else None


@lru_cache(maxsize=16)
def _directions(rig: Rig, sensor: str, size_wh: tuple[int, int], shape: tuple[int, int]) -> Float32:
    """Unit vectors (h, w, 3) in body coordinates of rays through the middles of cells; of a camera that nothing is
    known of they look ahead, in a field of view of 53 degrees. NaN where a lens sees nothing.
    """
    camera = rig.cameras.get(sensor)
    if camera is None or not_projectable(camera) is not None:
        f, right, down = size_wh[0], (size_wh[0] - 1) / 2, (size_wh[1] - 1) / 2
        camera = CameraModel(np.array([[f, 0, right], [0, f, down], [0, 0, 1.0]]), size_wh)
    (width, height), (rows, columns) = camera.size_wh, shape
    u, v = (np.arange(columns) + 0.5) * width / columns - 0.5, (np.arange(rows) + 0.5) * height / rows - 0.5
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rotation = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    if sensor in rig.mounts:
        rotation = rig.body_T_sensor(sensor)[:3, :3]
    result: Float32 = (rays(camera, uv) @ rotation.T).reshape(rows, columns, 3).astype(np.float32)
    result.setflags(write=False)
    return result


def _fit_ground(xyz: Float64) -> tuple[float, float, float]:
    """Slopes along x and y, and z at the origin, of the plane through the lowest points (N, 3) around the body."""
    around = xyz[np.sqrt((xyz * xyz).sum(axis=1)) < _AROUND_M]
    if len(around) < _FEWEST:
        return 0.0, 0.0, 0.0
    plane = np.array([0.0, 0.0, np.quantile(around[:, 2], 0.1)])
    for step_m in _STEPS_M:
        off = around[:, 2] - around[:, :2] @ plane[:2] - plane[2]
        x, y, z = around[np.abs(off) < step_m].T
        if len(x) < _FEWEST:
            break
        plane = np.linalg.lstsq(np.stack([x, y, np.ones(len(x))], axis=1), z)[0]
    return float(plane[0]), float(plane[1]), float(plane[2])


def _ground(directions: Float32, plane: tuple[float, float, float], site: Site) -> Float32:
    """One over the distance of flat ground (h, w), at least that of what is far. The camera is as high above it as its
    mount says, if a car's camera may be.
    """
    along_x, along_y, level = plane
    height = _HEIGHT_M
    if site.sensor in site.rig.mounts:
        x, y, z = site.rig.mounts[site.sensor].translation_m.tolist()
        height = z - along_x * x - along_y * y - level
        height = height if _HEIGHTS_M[0] <= height <= _HEIGHTS_M[1] else _HEIGHT_M
    normal = np.array([along_x, along_y, -1.0]) / height
    with np.errstate(invalid="ignore"):
        return np.asarray(np.fmax(directions @ normal.astype(np.float32), np.float32(1 / FAR_M)), np.float32)


def _nearest(uv: Float64, range_m: Float64, shape: tuple[int, ...], size_wh: tuple[int, int]) -> Float32:
    """One over the distance of the nearest of points (N, 2) in each cell (h, w), 0 without."""
    hits = np.zeros(shape[:2], np.float32)
    column, row = ((uv + 0.5) * (np.array(shape[1::-1]) / size_wh)).T
    place = np.clip(row, 0, shape[0] - 1).astype(np.int64) * shape[1] + np.clip(column, 0, shape[1] - 1).astype(
        np.int64
    )
    np.maximum.at(hits.reshape(-1), place, (1 / range_m).astype(np.float32))
    return hits


def _spacing(altitude_deg: Float64) -> float:
    """Mean angle between a LiDAR's channels [deg], 0 where there are no gaps between them."""
    used = np.unique(np.floor(altitude_deg / _BIN_DEG))
    num = 1 + np.count_nonzero(np.diff(used) > 1)
    return _BIN_DEG * float(used[-1] - used[0]) / (num - 1) if num > 1 else 0.0


def _spread(hit: Bool, hole_deg: float, directions: Float32) -> tuple[Float32, Bool]:
    """How much the nearest points say about each cell (h, w), 1 to 0; and which cells lie between points."""
    rows, columns = hit.shape
    middle, beside = directions[rows // 2, columns // 2], directions[rows // 2, columns // 2 - 1]
    step_deg = float(np.degrees(np.sqrt(((beside - middle) ** 2).sum())))
    if not step_deg > 0:  # too few cells, or a lens that sees nothing there
        step_deg = _BIN_DEG
    away_deg = cv2.distanceTransform((~hit).astype(np.uint8), cv2.DIST_L2, 5) * np.float32(step_deg)
    known = np.exp(-0.5 * (np.maximum(away_deg - np.float32(hole_deg), 0) / np.float32(_FADE_DEG)) ** 2)
    side = 2 * min(max(1, round(hole_deg / step_deg)), 40) + 1
    between = cv2.morphologyEx(hit.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    return np.asarray(known, np.float32), np.asarray(between > 0, np.bool_)


def _fill(values: Float32) -> Float32:
    """Fill zeros by the average of what is nearest: a pyramid of means over more and more cells."""
    height, width = values.shape
    weights = (values > 0).astype(np.float32)
    if min(height, width) > 1:
        size = (max(1, width // 2), max(1, height // 2))
        share = cv2.resize(weights, size, interpolation=cv2.INTER_AREA)
        mean = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
        coarse = _fill(np.where(share > 0, mean / np.maximum(share, 1e-6), 0).astype(np.float32))
        rest = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        return np.asarray(np.where(values > 0, values, rest), np.float32)
    held = values[values > 0]
    return np.where(values > 0, values, held.mean() if len(held) else 0.0).astype(np.float32)


def _sky(gray: Float32, directions: Float32) -> Bool:
    """Tell which cells (h, w) look like sky: above the horizon, even, bright, and one area with the image's top."""
    bright = gray > _SKY_SHARE * float(np.quantile(gray[::4, ::4], 0.95))
    contrast = cv2.blur(np.abs(gray - cv2.blur(gray, (5, 5))), (5, 5))
    with np.errstate(invalid="ignore"):
        maybe = bright & (contrast < _SKY_CONTRAST) & (directions[..., 2] > 0)
    num, areas = cv2.connectedComponents(maybe.astype(np.uint8), connectivity=4)
    is_sky = np.zeros(num, bool)
    is_sky[areas[0][areas[0] > 0]] = True
    return np.asarray(is_sky[areas], np.bool_)
