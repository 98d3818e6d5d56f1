"""Fixtures of the pipelines' tests."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.hostile.damage import join_proto, varint

Model = Callable[..., Path]

_ONNX_TYPES = {"float32": 1, "int64": 7}


def field(number: int, value: bytes | str | int) -> bytes:
    """One field of a protobuf message."""
    if isinstance(value, int):
        return join_proto(number, 0, varint(value))
    return join_proto(number, 2, value.encode() if isinstance(value, str) else value)


def tensor(name: str, values: np.ndarray, *, external: bool = False) -> bytes:
    dims = b"".join(field(1, n) for n in values.shape)
    kind = field(2, _ONNX_TYPES[values.dtype.name])
    if external:
        entry = field(1, "location") + field(2, "/etc/hostname")
        return dims + kind + field(8, name) + field(13, entry) + field(14, 1)
    return dims + kind + field(8, name) + field(9, values.tobytes())


def port(name: str, dtype: str, shape: Sequence[int | str]) -> bytes:
    dims = b"".join(field(1, field(1, n) if isinstance(n, int) else field(2, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, _ONNX_TYPES[dtype]) + field(2, dims)))


def encode_model(
    outputs: dict[str, np.ndarray],
    inputs: dict[str, tuple[str, Sequence[int | str]]],
    metadata: dict[str, str] | None = None,
    *,
    external: bool = False,
) -> bytes:
    """An ONNX file whose outputs are constants, whatever the image is."""
    graph = b""
    for key, value in outputs.items():
        graph += field(1, field(1, f"{key}_value") + field(2, key) + field(4, "Identity"))
        graph += field(5, tensor(f"{key}_value", value, external=external))
        graph += field(12, port(key, value.dtype.name, value.shape))
    graph += field(2, "test") + b"".join(field(11, port(n, *spec)) for n, spec in inputs.items())
    entries = b"".join(field(14, field(1, k) + field(2, v)) for k, v in (metadata or {}).items())
    return field(1, 8) + field(7, graph) + field(8, field(2, 13)) + entries


@pytest.fixture
def constant_model(tmp_path: Path) -> Model:
    """Writes such a file."""

    def write(*content: Any, name: str = "model.onnx", **how: Any) -> Path:
        path = tmp_path / name
        path.write_bytes(encode_model(*content, **how))
        return path

    return write


@pytest.fixture
def one_car(constant_model: Model) -> Path:
    """A DETR-like detector that sees the same car and pedestrian in every image."""
    return constant_model(
        {
            "labels": np.array([[2, 0, 7]], np.int64),
            "boxes": np.array([[[10, 20, 50, 60], [70, 20, 80, 60], [0, 0, 5, 5]]], np.float32),
            "scores": np.array([[0.9, 0.8, 0.1]], np.float32),
        },
        {"images": ("float32", (1, 3, 32, 32)), "orig_target_sizes": ("int64", (1, 2))},
    )
