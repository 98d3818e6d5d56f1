"""The inputs of each step of a training: a function of the settings and the step alone."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.training.samples import Sample
from fbench.pipelines.training.settings import INPUT_WH, TrainingSettings
from fbench.pipelines.training.views import View, crop, whole
from fbench.replay.draws import generator
from fbench.replay.errors import LogError
from fbench.replay.images import decode


@dataclass(frozen=True)
class Batcher:
    """Draws which images a step sees, and how."""

    samples: Sequence[Sample]
    settings: TrainingSettings

    def batches(self, first: int, last: int) -> Iterator[list[View]]:
        """Yield the batches of steps `first` to before `last`; the next one is made while one is in use."""
        with ThreadPoolExecutor(1, "fbench-views") as pool:
            waiting = pool.submit(self.batch, first)
            for step in range(first, last):
                views = waiting.result()
                if step + 1 < last:
                    waiting = pool.submit(self.batch, step + 1)
                yield views

    def batch(self, step: int) -> list[View]:
        """Views of one step."""
        is_whole = step % self.settings.whole_every == 0
        num = self.settings.wholes if is_whole else self.settings.crops
        chosen = generator(self.settings.seed, "samples", step).choice(len(self.samples), num)
        return [self._view(int(index), step, place, is_whole) for place, index in enumerate(chosen)]

    def _view(self, index: int, step: int, place: int, is_whole: bool) -> View:
        sample, draw = self.samples[index], generator(self.settings.seed, "view", step, place)
        pixels = decode(sample.image)
        if pixels is None:
            raise LogError(f"{sample.name}: the image can't be decoded")
        if is_whole:
            return whole(sample, pixels, INPUT_WH, draw)
        low, high = np.log(self.settings.zoom)
        height, width = pixels.shape[:2]
        scale = min(INPUT_WH[0] / width, INPUT_WH[1] / height) * float(np.exp(draw.uniform(low, high)))
        return crop(sample, pixels, self.settings.crop_wh, scale, draw)
