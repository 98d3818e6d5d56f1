"""A network that shows what it gets: each pixel of its input is a box whose scores are the pixel's channels."""

from collections.abc import Sequence

import numpy as np
from tests.pipelines.conftest import field, port, tensor

NAMES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
"""Red, green, blue, depth and radial velocity are scores of the first five."""


def encode_pixels(
    input_wh: tuple[int, int], side_px: float = 1.0, channels: int = 5, names: Sequence[str] = NAMES
) -> bytes:
    """An ONNX file with input (1, C, H, W) and an output as of YOLOv8; boxes are squares in the input."""
    width, height = input_wh
    v, u = np.mgrid[0:height, 0:width].reshape(2, -1) + 0.5
    cells = np.stack([u, v, np.full(u.size, side_px), np.full(u.size, side_px)])[None].astype(np.float32)
    rest = np.zeros((1, len(NAMES) - channels, u.size), np.float32)
    constants = {"cells": cells, "rest": rest, "shape": np.array([1, channels, u.size], np.int64)}
    axis = field(5, field(1, "axis") + field(3, 1) + field(20, 2))
    graph = field(1, _node("Reshape", ["images", "shape"], "flat"))
    graph += field(1, _node("Concat", ["cells", "flat", "rest"], "boxes") + axis)
    graph += field(2, "pixels") + b"".join(field(5, tensor(name, values)) for name, values in constants.items())
    graph += field(11, port("images", "float32", (1, channels, height, width)))
    graph += field(12, port("boxes", "float32", (1, 4 + len(NAMES), u.size)))
    entries = {"names": repr(dict(enumerate(names)))}
    more = b"".join(field(14, field(1, name) + field(2, text)) for name, text in entries.items())
    return field(1, 8) + field(7, graph) + field(8, field(2, 13)) + more


def encode_identity(shape: tuple[int, ...], name: str) -> bytes:
    """An ONNX file whose output is its input, called `name`."""
    graph = field(1, _node("Identity", [name], "out"))
    graph += field(2, "identity") + field(11, port(name, "float32", shape)) + field(12, port("out", "float32", shape))
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))


def _node(kind: str, inputs: list[str], output: str) -> bytes:
    return b"".join(field(1, name) for name in inputs) + field(2, output) + field(4, kind)
