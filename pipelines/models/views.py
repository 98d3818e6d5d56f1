"""The inputs of each step of a training on images: a function of the settings and the step alone."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import cv2
import numpy as np

from fbench.pipelines.models.samples import INPUT_WH, RgbdSettings, Sample, TrainingSettings, rarity
from fbench.pipelines.models.settings import chances
from fbench.pipelines.sensors.camera.channels import NO_POINTS, ImagePoints, draw_channels
from fbench.pipelines.sensors.camera.layouts import PAD_VALUE
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.images import Pixels, decode

_KEPT = 0.35  # Boxes of which less than this share is in the view are ignored
_NEAR_OBJECT = 0.8  # Share of crops that are laid around an object


@dataclass(frozen=True, eq=False)
class View:
    """An input of the network and what is in it."""

    pixels: Pixels  # (H, W, 3) RGB; (H, W, 5) with points, see `add_channels`
    xyxy: Float64  # (N, 4) [px]
    class_id: Int64  # (N,); -1 is ignored
    points: ImagePoints = NO_POINTS  # Of the input


def crop(
    sample: Sample, pixels: Pixels, size_wh: tuple[int, int], scale: float, weight: Float64, draw: np.random.Generator
) -> View:
    """Cut a window of `size_wh` out of an image (H, W, 3) BGR scaled by `scale`, mostly around an object, which is
    chosen by the weights (C,) of the classes.
    """
    height, width = pixels.shape[:2]
    wanted = np.array(size_wh) / scale
    objects = sample.xyxy[~sample.is_ignored]
    if len(objects) and draw.random() < _NEAR_OBJECT:
        chance = weight[sample.class_id[~sample.is_ignored]]
        one = objects[draw.choice(len(objects), p=chance / chance.sum())]
        center = np.asarray((one[:2] + one[2:]) / 2)
    else:
        center = np.asarray(draw.uniform(0, 1, 2) * np.array((width, height)))
    center = center + draw.uniform(-0.35, 0.35, 2) * wanted
    room = np.array([width, height]) - wanted
    corner = np.where(room > 0, np.clip(center - wanted / 2, 0, np.maximum(room, 0)), room * draw.uniform(0, 1, 2))
    return _view(sample, pixels, corner, scale, size_wh, draw)


def whole(sample: Sample, pixels: Pixels, size_wh: tuple[int, int], draw: np.random.Generator) -> View:
    """Fit the whole image (H, W, 3) BGR into `size_wh`."""
    height, width = pixels.shape[:2]
    scale = min(size_wh[0] / width, size_wh[1] / height)
    corner = (np.array([width, height]) - np.array(size_wh) / scale) / 2
    return _view(sample, pixels, corner, scale, size_wh, draw)


def _view(
    sample: Sample, pixels: Pixels, corner: Float64, scale: float, size_wh: tuple[int, int], draw: np.random.Generator
) -> View:
    shown, points = _scale(pixels, corner, scale, size_wh), sample.points.move(scale, corner)
    xyxy = (sample.xyxy - np.tile(corner, 2)) * scale
    if draw.random() < 0.5:
        shown, points = shown[:, ::-1], points.mirror(size_wh[0])
        xyxy = np.stack([size_wh[0] - xyxy[:, 2], xyxy[:, 1], size_wh[0] - xyxy[:, 0], xyxy[:, 3]], axis=1)
    inside = np.clip(xyxy, 0, np.tile(np.array(size_wh, np.float64), 2))
    kept = _area(inside) >= _KEPT * _area(xyxy)
    there = _area(inside) > 0
    ids = np.where(kept, sample.class_id, -1)
    return View(_in_other_light(shown[..., ::-1], draw), inside[there], ids[there], points)


def _scale(pixels: Pixels, corner: Float64, scale: float, size_wh: tuple[int, int]) -> Pixels:
    """Shrink first by areas, as the finished detector does, then cut; grey beyond the image."""
    height, width = pixels.shape[:2]
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    left, top = np.clip(np.floor(corner), 0, None).astype(int).tolist()
    right, bottom = np.minimum(np.ceil(corner + np.array(size_wh) / scale), (width, height)).astype(int).tolist()
    part = pixels[top:bottom, left:right]
    inner = (max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale)))
    small = cv2.resize(part, inner, interpolation=how)
    canvas = np.full((size_wh[1], size_wh[0], 3), PAD_VALUE, np.uint8)
    x, y = round((left - float(corner[0])) * scale), round((top - float(corner[1])) * scale)
    sx, sy, dx, dy = max(0, -x), max(0, -y), max(0, x), max(0, y)
    w, h = min(inner[0] - sx, size_wh[0] - dx), min(inner[1] - sy, size_wh[1] - dy)
    canvas[dy : dy + h, dx : dx + w] = small[sy : sy + h, sx : sx + w]
    return canvas


def _in_other_light(rgb: Pixels, draw: np.random.Generator) -> Pixels:
    """Change brightness, contrast, gamma and color a little, and add noise to some."""
    gain, gamma = draw.uniform(0.75, 1.3), draw.uniform(0.8, 1.25)
    tint, color = draw.uniform(0.93, 1.07, 3), draw.uniform(0.6, 1.4)
    table = np.clip((np.arange(256) / 255.0) ** gamma * gain * 255.0, 0, 255)
    towards_grey = color * np.eye(3) + (1 - color) / 3
    values = cv2.transform(cv2.LUT(rgb, table.astype(np.float32)), tint[:, None] * towards_grey)
    if draw.random() < 0.3:
        values += np.float32(draw.uniform(1, 6)) * draw.standard_normal(values.shape, np.float32)
    return np.clip(values, 0, 255, out=values).astype(np.uint8)


def _area(xyxy: Float64) -> Float64:
    sides = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 0)
    return sides[:, 0] * sides[:, 1]


def add_channels(view: View, settings: RgbdSettings, draw: np.random.Generator) -> View:
    """Draw the points of a view into it, where they or the image aren't missing."""
    lidar, radar, pixels = view.points.lidar, view.points.radar, view.pixels
    kinds = np.array([settings.without_points, settings.without_lidar, settings.without_radar, settings.without_image])
    missing = int(np.searchsorted(np.cumsum(kinds), draw.random(), side="right"))
    if missing in (0, 1):
        lidar = lidar[:0]
    if missing in (0, 2):
        radar = radar[:0]
    if missing == 3:
        pixels = np.full_like(pixels, PAD_VALUE)
    if draw.random() < settings.thinned:
        lidar = lidar[draw.random(len(lidar)) < draw.uniform(0.1, 1)]
        radar = radar[draw.random(len(radar)) < draw.uniform(0.1, 1)]
    size = (pixels.shape[1], pixels.shape[0])
    drawn = draw_channels(ImagePoints(lidar, radar, view.points.focal_px), size)
    return View(np.concatenate([pixels, drawn], axis=2), view.xyxy, view.class_id)


Made = TypeVar("Made")


def make_ahead(
    parts: Callable[[int], Iterator[Callable[[], Made]]], steps: range, threads: int
) -> Iterator[list[Made]]:
    """Yield what the parts of each step make, in order; those of the next steps are made while one is in use."""
    with ThreadPoolExecutor(threads, "fbench-views") as pool:
        waiting, upcoming = deque[list[Future[Made]]](), iter(steps)
        for _ in steps:
            while len(waiting) <= threads // 4 + 1 and (step := next(upcoming, None)) is not None:
                waiting.append([pool.submit(work) for work in parts(step)])
            yield [future.result() for future in waiting.popleft()]


@dataclass(frozen=True)
class Batcher:
    """Draws which images a step sees, and how."""

    samples: Sequence[Sample]
    settings: TrainingSettings
    threads: int = 2
    _weight: Float64 = field(init=False)  # (C,) of the classes
    _chance: Float64 = field(init=False)  # (S,) of the samples

    def __post_init__(self) -> None:
        weight = rarity(self.samples, self.settings.common)
        rarest = np.array([weight[s.class_id[~s.is_ignored]].max(initial=1) for s in self.samples])
        object.__setattr__(self, "_weight", weight)
        is_recorded = [sample.is_recorded for sample in self.samples]
        object.__setattr__(self, "_chance", chances(rarest, is_recorded, self.settings.recorded_share))

    def batches(self, first: int, last: int) -> Iterator[list[View]]:
        """Yield the batches of steps `first` to before `last`."""
        return make_ahead(self._views, range(first, last), self.threads)

    def batch(self, step: int) -> list[View]:
        """Views of one step."""
        return [make() for make in self._views(step)]

    def _views(self, step: int) -> Iterator[Callable[[], View]]:
        is_whole = step % self.settings.whole_every == 0
        num = self.settings.wholes if is_whole else self.settings.crops
        chosen = generator(self.settings.seed, "samples", step).choice(len(self.samples), num, p=self._chance)
        for place, index in enumerate(chosen.tolist()):
            yield partial(self._view, index, step, place, is_whole)

    def _view(self, index: int, step: int, place: int, is_whole: bool) -> View:
        sample, draw = self.samples[index], generator(self.settings.seed, "view", step, place)
        pixels = decode(sample.image)
        if pixels is None:
            raise LogError(f"{sample.name}: the image can't be decoded")
        if is_whole:
            view = whole(sample, pixels, INPUT_WH, draw)
        else:
            low, high = np.log(self.settings.zoom)
            height, width = pixels.shape[:2]
            scale = min(INPUT_WH[0] / width, INPUT_WH[1] / height) * float(np.exp(draw.uniform(low, high)))
            view = crop(sample, pixels, self.settings.crop_wh, scale, self._weight, draw)
        return add_channels(view, self.settings, draw) if isinstance(self.settings, RgbdSettings) else view
