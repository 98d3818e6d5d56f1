"""Comparison of LiDARs with cameras: whether edges fit, and which errors of rotation would be noticed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.data.arrays import Float32, Float64, Int64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel
from fbench.replay.geometry.camera import in_image, project
from fbench.replay.geometry.transforms import inverse, transform
from fbench.reports.preview import draw
from fbench.reports.preview.camera import whole
from fbench.reports.preview.draw import INK, of_depth
from fbench.reports.preview.sample import Direction, Sample, edge_strength, sample_image

WIDTH_PX = 640
STEP_DEG = 0.5
REACH_DEG = 4.0
MIN_EDGES = 60  # With fewer edges of depth in all images nothing is said
MIN_ANGLE_DEG, MIN_GAIN, MIN_BLOCKS, MIN_SIGMAS = 1.0, 0.04, 8, 3.0
"""A turn is reported that is at least so large, raises the score by this share of it, and by so many of the deviations
that as many stripes of images explain."""
_SURE_SIGMAS = 3.5  # What would be noticed is said where it would be with something to spare
MIN_SCORE = 1.15
AXES = ("pitch", "yaw", "roll")
"""Turns about the axes of a camera: x right, y down, z forward."""
_STRIPES, _BLOCK_EDGES = 12, 5
_MAX_EDGES = 600  # Of one frame and direction; more tell nothing new
_PLANTED_DEG = (1.0, 1.5, 2.0, 3.0)
_REACH = round(REACH_DEG / STEP_DEG)
_MIDDLE = _REACH + round(max(_PLANTED_DEG) / STEP_DEG)
_DIRECTIONS: tuple[Direction, ...] = ("upright", "level")


@dataclass(frozen=True)
class Alignment:
    """What turning LiDAR edges about the axes of a camera (x right, y down, z forward) gives."""

    camera: str
    num_edges: int
    turn_deg: tuple[float, float, float]  # The rotation vector that fits best, in steps of half a degree
    score: float  # Mean strength of image edges under LiDAR edges, as calibrated; the mean of the image is 1
    best_score: float
    is_clear: bool  # Whether that turn is better than the calibration all over the images, by more than chance
    num_blocks: int  # Stripes of images with enough edges, of all frames and both directions together
    noticed_deg: tuple[float | None, float | None, float | None] = (None, None, None)
    """From which error on, to either side and about one axis alone, it would have been clear; `None`: from none."""

    @property
    def is_off(self) -> bool:
        """Whether another rotation is clearly better."""
        return (
            self.is_clear and not self.is_unclear and float(np.sqrt(np.sum(np.square(self.turn_deg)))) >= MIN_ANGLE_DEG
        )

    @property
    def is_unclear(self) -> bool:
        """Whether a clearly better turn is at the border of the search, as where all edges are on one object."""
        return self.is_clear and max(abs(turn) for turn in self.turn_deg) >= REACH_DEG

    @property
    def is_lost(self) -> bool:
        """Whether edges of LiDAR and image have nothing to do with each other, and no turn mends it."""
        return self.num_blocks >= MIN_BLOCKS and self.score < MIN_SCORE and not self.is_off

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
        if self.is_off:
            most = max(abs(turn) for turn in self.turn_deg)
            large = [(t, name) for t, name in zip(self.turn_deg, "xyz", strict=True) if abs(t) >= min(1.0, most)]
            turns = [f"{t:+.1f} deg about the camera's {name} axis" for t, name in large]
            scores = f"score {self.score:.2f} → {self.best_score:.2f}, {self.num_edges} edges"
            return f"LiDAR edges fit the image better when turned by {' and '.join(turns)} ({scores})"
        known = [(deg, name) for deg, name in zip(self.noticed_deg, AXES, strict=True) if deg is not None]
        open_ = [name for deg, name in zip(self.noticed_deg, AXES, strict=True) if deg is None]
        score = f"{self.num_edges} edges, score {self.score:.2f}"
        if not known:
            return f"can't be judged: no error of up to {max(_PLANTED_DEG):g} deg would be noticed ({score})"
        within = ", ".join(f"{name} within {deg:g} deg" for deg, name in known)
        rest = f"; {' and '.join(open_)} can't be judged" if open_ else ""
        return f"LiDAR edges fit the image as calibrated: {within}{rest} ({score})"


class _Evidence(NamedTuple):
    """One image, and the edges in one direction of the sweeps that go with it."""

    direction: Direction
    field: Float32  # Strength of edges in that direction; the mean is 1
    edges: Float64  # (N, 3) in camera coordinates [m]
    stripes: Int64  # (N,) in which upright stripe of the image each one lies, as calibrated


@dataclass(frozen=True)
class _Scene:
    """All evidence of one camera."""

    model: CameraModel
    evidence: Sequence[_Evidence]

    def of(self, direction: Direction) -> list[_Evidence]:
        """That of one direction."""
        return [found for found in self.evidence if found.direction == direction]

    @cached_property
    def blocks(self) -> tuple[Int64, ...]:
        """Numbers (N,) of the stripes of images in which edges lie, by direction; different in each image."""
        every = [[_STRIPES * i + found.stripes for i, found in enumerate(self.of(d))] for d in _DIRECTIONS]
        return tuple(np.concatenate(own) if own else np.zeros(0, np.int64) for own in every)


@dataclass(frozen=True)
class _Values:
    """Strength of images under edges (N,) at one rotation, by direction; NaN for edges outside of the image."""

    strength: tuple[Float64, ...]

    @cached_property
    def score(self) -> float:
        """Mean over directions, each of which is the mean of its edges."""
        return _mean_of([own[np.isfinite(own)] for own in self.strength])


def _mean_of(of_directions: Sequence[Float64]) -> float:
    means = [float(np.mean(own)) for own in of_directions if len(own) >= _BLOCK_EDGES]
    return float(np.mean(means)) if means else 1.0


def align(samples: Sequence[Sample], camera: str) -> Alignment:
    """Compare the calibrated rotation with others up to 4 degrees away.

    The score is the mean strength of image edges where edges of depth are projected to: largest where both coincide
    (Levinson and Thrun 2013); upright edges and level ones count alike. One axis after the other is searched, twice.
    Errors that would have been noticed are found by planting them: with the same edges, the calibration is turned about
    one axis, and it is seen whether turning it back is clearly better.
    """
    evidence = [found for sample in samples for found in _evidence(sample, camera)]
    num = sum(len(found.edges) for found in evidence)
    model = next((s.rig.cameras[camera] for s in samples if camera in s.rig.cameras), None)
    if num < MIN_EDGES or model is None:
        return Alignment(camera, num, (0.0, 0.0, 0.0), 0.0, 0.0, is_clear=False, num_blocks=0)
    few = {d for d in _DIRECTIONS if sum(len(e.edges) for e in evidence if e.direction == d) < MIN_EDGES}
    counted = [found for found in evidence if found.direction not in few] or evidence
    scene = _Scene(model, counted)
    lines = [_measure_line(scene, axis) for axis in range(3)]
    here, best = lines[0][_MIDDLE], _best(scene)
    # What is planted is found by turning about one axis, and so this is tried, too.
    turns = [best, *(_turn(axis, _best_step(line, _MIDDLE) - _MIDDLE) for axis, line in enumerate(lines))]
    found = [(turn, _measure(scene, turn)) for turn in turns]
    clear = [item for item in found if _is_clear(scene, here, item[1])]
    turn, there = max(clear or found[:1], key=lambda item: item[1].score)
    x, y, z = (round(float(value), 3) + 0.0 for value in turn)
    pitch, yaw, roll = (_noticeable_deg(scene, line) for line in lines)
    num_blocks = sum(int(np.sum(np.bincount(blocks) >= _BLOCK_EDGES)) for blocks in scene.blocks)
    return Alignment(camera, num, (x, y, z), here.score, there.score, bool(clear), num_blocks, (pitch, yaw, roll))


def edges_of(sample: Sample, camera: str, direction: Direction = "upright") -> Float64:
    """Edges of depth (N, 3) [m] of all placed LiDARs, in coordinates of a camera."""
    edges = sample.depth_edges_m if direction == "upright" else sample.level_edges_m
    return transform(inverse(sample.rig.body_T_sensor(camera)), edges)


def _evidence(sample: Sample, camera: str) -> list[_Evidence]:
    if camera not in sample.cameras or camera not in sample.rig.cameras:
        return []
    found, model = [], sample.rig.cameras[camera]
    for direction in _DIRECTIONS:
        edges = edges_of(sample, camera, direction)
        uv, _ = project(model, edges)
        seen = np.flatnonzero(in_image(model, uv))
        seen = seen[:: max(1, -(-len(seen) // _MAX_EDGES))]
        if len(seen):
            field = edge_strength(sample.image(camera), WIDTH_PX, direction)
            field = (field / np.float32(max(float(field.mean(dtype=np.float64)), 1e-6))).astype(np.float32)
            across = np.clip(uv[seen, 0] / model.size_wh[0], 0, 0.999)
            found.append(_Evidence(direction, field, edges[seen], np.floor(across * _STRIPES).astype(np.int64)))
    return found


def _best(scene: _Scene) -> Float64:
    """Rotation vector [deg] with the highest score; of equal ones the one that turns least."""
    turn = np.zeros(3)
    steps = sorted(np.arange(-REACH_DEG, REACH_DEG + STEP_DEG / 2, STEP_DEG), key=abs)
    for axis in (1, 0, 2, 1, 0, 2):
        candidates = [np.where(np.arange(3) == axis, step, turn) for step in steps]
        scores = [_measure(scene, candidate).score for candidate in candidates]
        turn = candidates[int(np.argmax(scores))]
    return turn


def _turn(axis: int, step: int) -> Float64:
    """Rotation vector [deg] about one axis."""
    return np.where(np.arange(3) == axis, STEP_DEG * step, 0.0)


def _measure_line(scene: _Scene, axis: int) -> list[_Values]:
    """Values of all turns about one axis that can be planted or mend what is planted; as calibrated in the middle."""
    return [_measure(scene, _turn(axis, step)) for step in range(-_MIDDLE, _MIDDLE + 1)]


def _best_step(line: Sequence[_Values], at: int) -> int:
    """Index of the highest score within reach of another one; of equal ones the nearest."""
    near = sorted(range(at - _REACH, at + _REACH + 1), key=lambda i: abs(i - at))
    return max(near, key=lambda i: line[i].score)


def _noticeable_deg(scene: _Scene, line: Sequence[_Values]) -> float | None:
    """From which error on all errors about one axis, to either side, are clear when they are planted; `None`: none."""
    noticed = None
    for planted in sorted(_PLANTED_DEG, reverse=True):
        for at in (_MIDDLE - round(planted / STEP_DEG), _MIDDLE + round(planted / STEP_DEG)):
            best = _best_step(line, at)
            is_reported = MIN_ANGLE_DEG <= STEP_DEG * abs(best - at) < REACH_DEG
            if not (is_reported and _is_clear(scene, line[at], line[best], _SURE_SIGMAS)):
                return noticed
        noticed = planted
    return noticed


def _is_clear(scene: _Scene, here: _Values, there: _Values, sigmas: float = MIN_SIGMAS) -> bool:
    """Whether a rotation is better than another, by enough and all over the images: one object alone proves little.

    Edges count that are in the image with both. The stripes of images are taken as independent: their mean gain has to
    be larger than several of its standard deviations, in one direction while the other doesn't disagree, or in both
    together.
    """
    before, after, gains = [], [], []
    for blocks, a, b in zip(scene.blocks, here.strength, there.strength, strict=True):
        both = np.isfinite(a) & np.isfinite(b)
        before.append(a[both])
        after.append(b[both])
        nums = np.bincount(blocks[both])
        own = np.bincount(blocks[both], b[both] - a[both])[nums >= _BLOCK_EDGES] / nums[nums >= _BLOCK_EDGES]
        gains += [own] if len(own) >= MIN_BLOCKS else []
    best = _mean_of(after)
    if not gains or best - _mean_of(before) <= MIN_GAIN * best:
        return False
    means = np.array([np.mean(gain) for gain in gains])
    deviations = np.array([np.std(gain, ddof=1) / np.sqrt(len(gain)) for gain in gains])
    ratios = means / np.maximum(deviations, 1e-9)
    together = float(np.sum(means) / max(float(np.sqrt(np.sum(deviations**2))), 1e-9))
    return bool(np.min(ratios) > -1 and max(together, float(np.max(ratios))) > sigmas)


def _measure(scene: _Scene, turn_deg: Float64) -> _Values:
    """Strength of the images at LiDAR edges that are turned by a rotation vector [deg] in camera coordinates."""
    turned, model = np.eye(4), scene.model
    turned[:3, :3] = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    strength = []
    for direction in _DIRECTIONS:
        own = [np.zeros(0)]
        for found in scene.of(direction):
            uv, _ = project(model, transform(turned, found.edges))
            values = sample_image(found.field, (uv + 0.5) * (WIDTH_PX / model.size_wh[0]) - 0.5)
            own.append(np.where(in_image(model, uv), values, np.nan))
        strength.append(np.concatenate(own))
    return _Values(tuple(strength))


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
