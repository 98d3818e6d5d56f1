"""An ONNX model of a known layout: any number of images in, candidates of each out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.pipelines.camera import onnx_file
from fbench.pipelines.camera.candidates import Candidates
from fbench.pipelines.camera.layouts import Size
from fbench.pipelines.camera.placing import PAD_VALUE
from fbench.pipelines.camera.recognise import DEFAULT_SIDE_PX, recognise
from fbench.replay.arrays import Array
from fbench.replay.errors import ModelError
from fbench.replay.images import Pixels

MAX_BATCH_PX = 1 << 24
"""Pixels of the inputs of one call, where the model leaves their number free: 200 MB as float32."""


@dataclass(frozen=True, eq=False)
class Batch:
    """The inputs of one call."""

    feeds: dict[str, Array]
    sizes_wh: Sequence[Size]
    """Sizes of the images [px], those that only fill the batch included."""
    num: int
    """How many images come first that count."""


class Model:
    """Runs one ONNX file on the CPU.

    It is tried on blank images when it is loaded, because headers don't tell everything: a graph can be made for
    one image although its header leaves their number free.

    Raises:
        ConfigError: where the file is missing.
        ModelError: where it can't be used.
    """

    def __init__(self, path: Path, threads: int, input_wh: Size | None) -> None:
        self._path = path
        try:
            self._session = onnx_file.load(path, threads)
            header = onnx_file.header(self._session)
            self._layout = recognise(header, input_wh)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error
        self._size = self._layout.input_wh or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
        self._num = self._images_a_call()
        self.metadata = header.metadata

    def batches(self, images: Sequence[Pixels]) -> list[Batch]:
        """Fit images (H, W, 3) BGR into inputs, as many a call as the model takes."""
        return [self._batch(images[i : i + self._num], self._num) for i in range(0, len(images), self._num)]

    def run(self, batch: Batch, min_score: float) -> list[Candidates]:
        """Candidates of each image, in pixels from its upper left corner.

        Raises:
            ModelError: where the model fails, or its outputs aren't as its header says.
        """
        try:
            outputs = self._session.run(None, batch.feeds)
            return self._layout.read(outputs, batch.sizes_wh, min_score)[: batch.num]
        except (*onnx_file.ORT_ERRORS, IndexError, TypeError) as error:
            raise ModelError(f"{self._path}: the model failed ({onnx_file.first_line(error)})") from error

    def _batch(self, images: Sequence[Pixels], num: int) -> Batch:
        """Repeat the last image where the model takes a fixed number of them."""
        filled = [*images, *[images[-1]] * (num - len(images))] if self._layout.batch else images
        sizes = [(image.shape[1], image.shape[0]) for image in filled]
        return Batch(self._layout.feeds(filled), sizes, len(images))

    def _images_a_call(self) -> int:
        most = self._layout.batch or max(1, MAX_BATCH_PX // (self._size[0] * self._size[1]))
        if self._layout.batch is None and most > 1 and self._takes(2):
            return most
        fixed = self._layout.batch or 1
        self._try(fixed)
        return fixed

    def _takes(self, num: int) -> bool:
        try:
            self._try(num)
        except ModelError:
            return False
        return True

    def _try(self, num: int) -> None:
        blank = np.full((self._size[1], self._size[0], 3), PAD_VALUE, np.uint8)
        self.run(self._batch([blank] * num, num), 0.0)
