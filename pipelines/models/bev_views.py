"""Views for each step of a training of the bird's-eye network: a function of the settings and the step alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fbench.pipelines.models.bev_samples import BevSample, BevSettings, BevView, judge_boxes
from fbench.pipelines.models.settings import chances
from fbench.pipelines.models.views import make_ahead
from fbench.pipelines.sensors.bev.grid import REACH_M, BevPoints
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float32, Float64

_NEAREST_M = 4.0  # Of clutter to the body's origin
_LONG = 0.3  # Share of things that are long, such as fences


def view(sample: BevSample, settings: BevSettings, draw: np.random.Generator) -> BevView:
    """Change a frame in ways that leave it a frame: with clutter, turned, mirrored, scaled, thinned, without a kind of
    sensor.
    """
    points, boxes, eye = sample.points, sample.boxes.astype(np.float64), sample.eye.astype(np.float64)
    if draw.random() < settings.cluttered:
        points = add_clutter(points, sample.boxes, settings.clutter, draw)
    sensors = int(draw.choice(3, p=np.array(settings.sensors)))
    lidar, radar = points.lidar.astype(np.float64), points.radar.astype(np.float64)
    if sensors != 0 and len(lidar) and len(radar):
        lidar, radar = (lidar, radar[:0]) if sensors == 1 else (lidar[:0], radar)
    if draw.random() < settings.thinned:
        lidar = _thin(lidar, eye, settings, draw)
        radar = radar[draw.random(len(radar)) < draw.uniform(settings.least_kept, 1)]
    if draw.random() < settings.turned:
        angle = draw.uniform(-settings.turn_rad, settings.turn_rad)
        rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        for rows in (lidar, radar, boxes):
            rows[:, :2] = rows[:, :2] @ rotation
        boxes[:, 7:] = boxes[:, 7:] @ rotation
        boxes[:, 6] += angle
    if draw.random() < 0.5:
        for rows, columns in ((lidar, [1]), (radar, [1]), (boxes, [1, 6, 8])):
            rows[:, columns] *= -1
    scale, shift = 1 + settings.scale * draw.uniform(-1, 1), settings.shift_m * draw.uniform(-1, 1)
    lidar *= scale
    radar *= scale
    boxes[:, [0, 1, 2, 3, 4, 5, 7, 8]] *= scale
    for rows in (lidar, radar, boxes):
        rows[:, 2] += shift
    found = BevPoints(lidar.astype(np.float32), radar.astype(np.float32))
    return judge_boxes(found, boxes.astype(np.float32), sample.class_id, settings.least_points)


@dataclass(frozen=True)
class _Thing:
    """Something that stands around and is nothing to be found."""

    xy: Float64  # (2,) of its middle [m]
    range_m: float
    width_m: float  # Across, two standard deviations of its points
    height_m: float
    length_m: float  # 0 where it isn't long
    along: Float64  # (2,) unit vector of its length

    def place(self, num: int, width_m: float, draw: np.random.Generator) -> Float64:
        """Return x and y (`num`, 2) of points on it."""
        along = self.along * draw.uniform(-0.5, 0.5, (num, 1)) * self.length_m
        return self.xy + (along + width_m / 2 * draw.standard_normal((num, 2)))


def add_clutter(points: BevPoints, boxes: Float32, mean: float, draw: np.random.Generator) -> BevPoints:
    """Add bushes, poles, fences and the like, on average `mean` of them, as clusters of points and of standing echoes
    beside the boxes (G, 9): recordings show more of them than a simulation does. They hide nothing.
    """
    lidar: list[Float32 | Float64] = [points.lidar]
    radar: list[Float32 | Float64] = [points.radar]
    for _ in range(int(draw.poisson(mean * draw.uniform(0, 2)))):
        thing = _draw_thing(draw)
        room = boxes[:, 3] / 2 + 2.5 * thing.width_m + thing.length_m / 2 + 0.7
        if (np.hypot(boxes[:, 0] - thing.xy[0], boxes[:, 1] - thing.xy[1]) < room).any():
            continue
        if len(points.lidar) and draw.random() < 0.85:
            lidar.append(_draw_points(thing, draw))
        if len(points.radar) and draw.random() < 0.7:
            radar.append(_draw_echoes(thing, draw))
    return BevPoints(np.concatenate(lidar, dtype=np.float32), np.concatenate(radar, dtype=np.float32))


def _draw_thing(draw: np.random.Generator) -> _Thing:
    if draw.random() < 0.5:  # evenly on the ground, else evenly over the range
        range_m = float(np.sqrt(draw.uniform(_NEAREST_M**2, REACH_M**2)))
    else:
        range_m = draw.uniform(_NEAREST_M, REACH_M)
    azimuth = draw.uniform(-np.pi, np.pi)
    width_m, height_m = draw.uniform(0.1, 1.2), draw.uniform(0.4, 4.5)
    length_m = draw.uniform(2, 12) if draw.random() < _LONG else 0.0
    along = draw.uniform(0, np.pi)
    return _Thing(
        range_m * np.array([np.cos(azimuth), np.sin(azimuth)]), range_m, width_m, height_m, length_m,
        np.array([np.cos(along), np.sin(along)]),
    )  # fmt: skip


def _draw_points(thing: _Thing, draw: np.random.Generator) -> Float64:
    """Points of a LiDAR (N, 3) on a thing, fewer with the distance; mostly on channels."""
    num = int(np.exp(draw.uniform(0, np.log(max(2.0, 6000 / thing.range_m**1.3)))))
    xy = thing.place(num, thing.width_m, draw)
    height = draw.uniform(min(draw.uniform(-0.2, 0.8), thing.height_m - 0.1), thing.height_m, num)
    step_m = np.radians(draw.uniform(0.2, 2.5)) * thing.range_m  # between channels
    if draw.random() < 0.6:
        height = np.round(height / step_m) * step_m + 0.02 * draw.standard_normal(num)
    return np.column_stack([xy, height])


def _draw_echoes(thing: _Thing, draw: np.random.Generator) -> Float64:
    """Echoes (M, 4) of a thing."""
    num = int(np.exp(draw.uniform(0, np.log(40))))
    xy = thing.place(num, 0.3 + thing.width_m, draw)
    height = draw.uniform(-0.3, thing.height_m, num) + 0.3 * draw.standard_normal(num)
    return np.column_stack([xy, height, 0.12 * draw.standard_normal(num)])


def _thin(lidar: np.ndarray, eye: np.ndarray, settings: BevSettings, draw: np.random.Generator) -> np.ndarray:
    """Keep one of several neighboring channels, or points by chance."""
    if draw.random() < 0.6:
        off = lidar - eye
        band = np.floor(np.arctan2(off[:, 2], np.hypot(off[:, 0], off[:, 1])) / settings.band_rad).astype(np.int64)
        of = int(draw.choice(settings.bands))
        return lidar[band % of == int(draw.integers(of))]
    return lidar[draw.random(len(lidar)) < draw.uniform(settings.least_kept, 1)]


@dataclass(frozen=True)
class BevBatcher:
    """Draws which frames a step sees, and how."""

    samples: Sequence[BevSample]
    settings: BevSettings
    threads: int = 2
    _chance: Float64 | None = field(init=False)  # (S,) of the samples; `None` where all are equally likely

    def __post_init__(self) -> None:
        is_recorded = [sample.is_recorded for sample in self.samples]
        chance = chances(np.ones(len(is_recorded)), is_recorded, self.settings.recorded_share)
        object.__setattr__(self, "_chance", chance if len(set(is_recorded)) == 2 else None)

    def batches(self, first: int, last: int) -> Iterator[list[BevView]]:
        """Yield the batches of steps `first` to before `last`."""
        return make_ahead(self._views, range(first, last), self.threads)

    def _views(self, step: int) -> Iterator[partial[BevView]]:
        seed, num = self.settings.seed, self.settings.batch
        chosen = generator(seed, "samples", step).choice(len(self.samples), num, p=self._chance)
        for place, index in enumerate(chosen.tolist()):
            yield partial(view, self.samples[index], self.settings, generator(seed, "view", step, place))
