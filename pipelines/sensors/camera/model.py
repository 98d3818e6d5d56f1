"""ONNX models: a file from a stranger becomes a session, or an error in one line.

Loading such a model would read paths that the file names. Walks the protobuf wire format: numbers of fields are
those of onnx.proto (ONNX, Apache-2.0).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state

from fbench.pipelines.sensors.camera.families import DEFAULT_SIDE_PX, RGB, recognize
from fbench.pipelines.sensors.camera.layouts import PAD_VALUE, Candidates, ModelHeader, Placement, Port, Size
from fbench.pipelines.sensors.camera.providers import open_session
from fbench.replay.contracts.errors import ConfigError, ModelError
from fbench.replay.data.arrays import Array
from fbench.replay.data.images import Pixels

_DATA_LOCATION, _EXTERNAL = 14, 1
_DIMS = 1
_CHILDREN: Mapping[str, Mapping[int, str]] = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}


def refers_to_files(data: bytes) -> bool:
    """Tell whether any tensor of the model is stored outside of `data`. Raises ModelError for what isn't protobuf."""
    return any((_DATA_LOCATION, _EXTERNAL) in tensor for tensor in _tensors(data))


def count_parameters(data: bytes) -> int:
    """Count the numbers in all tensors that the model holds. Raises ModelError for what isn't protobuf."""
    return sum(math.prod(_dims(tensor)) for tensor in _tensors(data))


def _tensors(data: bytes) -> Iterator[list[tuple[int, int | memoryview]]]:
    """Yield the fields of each tensor, as number and value."""
    todo = [("model", memoryview(data))]
    while todo:
        kind, message = todo.pop()
        found = list(_fields(message))
        if kind == "tensor":
            yield found
        for number, value in found:
            child = _CHILDREN[kind].get(number)
            if child and isinstance(value, memoryview):
                todo.append((child, value))


def _dims(tensor: list[tuple[int, int | memoryview]]) -> Iterator[int]:
    for number, value in tensor:
        if number == _DIMS and isinstance(value, int):
            yield value
        elif number == _DIMS and isinstance(value, memoryview):  # packed, as proto3 writes them
            at = 0
            while at < len(value):
                dim, at = _varint(value, at)
                yield dim


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Numbers and values of one message's fields; bytes are not copied."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        wire = key & 7
        if wire == 0:
            number, at = _varint(message, at)
            yield key >> 3, number
            continue
        size, at = _varint(message, at) if wire == 2 else ({1: 8, 5: 4}.get(wire, -1), at)
        if size < 0 or at + size > len(message):
            raise ModelError("not an ONNX file")
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            break
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return value, at
    raise ModelError("not an ONNX file")


# onnxruntime's exceptions derive from Exception one by one; these are all that loading and running raise.
_ORT = "EPFail Fail InvalidArgument InvalidGraph InvalidProtobuf NoSuchFile NotImplemented RuntimeException"
ORT_ERRORS = (*(getattr(onnxruntime_pybind11_state, name) for name in _ORT.split()), RuntimeError, ValueError)


def read_model(path: Path) -> bytes:
    """Return the content of an ONNX file. Raises ConfigError where it can't be read, ModelError where it isn't one, or
    refers to other files.
    """
    try:
        if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
            raise ConfigError(f"{path}: weights can't be read (not a regular file)")
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: weights can't be read ({error.strerror or error})") from error
    except ValueError as error:  # a name that no file can have
        raise ConfigError(f"{path}: weights can't be read ({error})") from error
    if refers_to_files(data):
        raise ModelError("the model keeps weights in other files, export it as one file")
    return data


def load(path: Path, threads: int) -> Any:
    """Open weights on the device that was chosen, see `contracts.devices`. Raises ConfigError where the device can't be
    used, ModelError where the weights can't be run, and what `read_model` raises.
    """
    data = read_model(path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Idle threads that spin cost half as much CPU again, and slow everything where cores are shared.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # what matters comes back as an exception
    try:
        session = open_session(data, options)
        _ = [port.name for port in (*session.get_inputs(), *session.get_outputs())]
        return session
    except UnicodeDecodeError as error:
        raise ModelError("a name in the model isn't UTF-8") from error
    except ORT_ERRORS as error:
        raise ModelError(f"not an ONNX model that can be run ({first_line(error)})") from error


def first_line(error: Exception) -> str:
    """The first line of an error's text, shortened."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


MAX_BATCH_PX = 1 << 24  # Pixels of the inputs of one call, where the model leaves their number free: 200 MB as float32


@dataclass(frozen=True, eq=False)
class Batch:
    """The inputs of one call."""

    feeds: dict[str, Array]
    sizes_wh: Sequence[Size]  # Sizes of the images [px], those that only fill the batch included
    num: int  # How many images come first that count


class Model:
    """Runs one ONNX file.

    It is tried on blank images when it is loaded, because headers don't tell everything: a graph can be made for one
    image although its header leaves their number free. Raises ConfigError where the file is missing. Raises ModelError
    where it can't be used. Its input has so many `channels`: those of an image, and what else is drawn into it.
    """

    def __init__(self, path: Path, threads: int, input_wh: Size | None, channels: int = RGB) -> None:
        self._path, self._num_drawn = path, channels - RGB
        try:
            self._session = load(path, threads)
            inputs, outputs = (
                tuple(Port(p.name, p.type, tuple(s if isinstance(s, int) else None for s in p.shape)) for p in ports)
                for ports in (self._session.get_inputs(), self._session.get_outputs())
            )
            header = ModelHeader(inputs, outputs, dict(self._session.get_modelmeta().custom_metadata_map))
            self._layout = recognize(header, input_wh, channels)
        except UnicodeDecodeError as error:
            raise ModelError(f"{path}: metadata of the model aren't UTF-8") from error
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error
        self._size = self._layout.input_wh or (DEFAULT_SIDE_PX, DEFAULT_SIDE_PX)
        self.metadata, self.family, self.input_wh = header.metadata, self._layout.family, self._layout.input_wh
        self._num = self._layout.batch or max(1, MAX_BATCH_PX // (self._size[0] * self._size[1]))
        with suppress(ModelError):
            if self._layout.batch is None and self._num > 1:
                self._try(2)
                return
        self._num = self._layout.batch or 1
        self._try(self._num)

    def placement(self, size_wh: Size) -> tuple[Placement, Size]:
        """Where an image of this size lies in the input, and the input's own size."""
        return self._layout.placement(size_wh), self.input_wh or size_wh

    def batches(self, images: Sequence[Pixels], drawn: Sequence[Pixels] = ()) -> list[Batch]:
        """Fit images (H, W, 3) BGR into inputs, as many a call as the model takes; with the further channels of each
        input (H, W, C) as they are `drawn`.
        """
        starts = range(0, len(images), self._num)
        return [self._batch(images[i : i + self._num], drawn[i : i + self._num], self._num) for i in starts]

    def run(self, batch: Batch, min_score: float) -> list[Candidates]:
        """Candidates of each image, in pixels from its upper left corner. Raises ModelError where the model fails, or
        its outputs aren't as its header says.
        """
        try:
            outputs = self._session.run(None, batch.feeds)
            return self._layout.read(outputs, batch.sizes_wh, min_score)[: batch.num]
        except (*ORT_ERRORS, IndexError, TypeError) as error:
            raise ModelError(f"{self._path}: the model failed ({first_line(error)})") from error

    def _batch(self, images: Sequence[Pixels], drawn: Sequence[Pixels], num: int) -> Batch:
        """Repeat the last image where the model takes a fixed number of them."""
        at = [min(i, len(images) - 1) for i in range(num if self._layout.batch else len(images))]
        feeds, name = self._layout.feeds([images[i] for i in at]), self._layout.image_input
        if drawn:
            planes = np.stack([drawn[i] for i in at]).transpose(0, 3, 1, 2) * np.float32(1 / 255)
            feeds[name] = np.concatenate([feeds[name], planes], axis=1)
        return Batch(feeds, [(images[i].shape[1], images[i].shape[0]) for i in at], len(images))

    def _try(self, num: int) -> None:
        blank = np.full((self._size[1], self._size[0], 3), PAD_VALUE, np.uint8)
        drawn = np.zeros((*blank.shape[:2], self._num_drawn), np.uint8)
        self.run(self._batch([blank] * num, [drawn] * num if self._num_drawn else (), num), 0.0)


@dataclass(frozen=True)
class ModelFacts:
    """What a file with weights is."""

    family: str
    input_wh: Size | None  # Size of the input [px]; `None`: that of the image
    num_bytes: int
    num_parameters: int


def describe_model(path: Path, input_wh: Size | None = None) -> ModelFacts:
    """Load a model and return what it is. Raises as `Model`."""
    model, data = Model(path, 1, input_wh), path.read_bytes()
    return ModelFacts(model.family, model.input_wh, len(data), count_parameters(data))
