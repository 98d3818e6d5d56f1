from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.sensors.camera.model import refers_to_files
from fbench.replay.contracts.errors import ModelError


def message(number: int, data: bytes) -> bytes:
    """A field that holds a message, shorter than 128 bytes."""
    return bytes([number << 3 & 0x7F | 2 | (0x80 if number > 15 else 0)]) + (
        bytes([number >> 4]) if number > 15 else b""
    ) + bytes([len(data)]) + data  # fmt: skip


INSIDE = message(8, b"weights") + message(9, b"\0\0\0\0")
OUTSIDE = message(8, b"weights") + bytes([14 << 3, 1])


@pytest.mark.parametrize(
    "path",
    [
        (7, 5),  # graph, initializer
        (7, 1, 5, 5),  # graph, node, attribute, tensor
        (7, 1, 5, 10),  # ... tensors
        (7, 1, 5, 6, 5),  # ... a graph inside of a node (If, Loop)
        (7, 1, 5, 11, 5),
        (7, 15, 1),  # graph, sparse initializer, values
        (7, 1, 5, 22, 2),  # ... a sparse tensor's indices
        (25, 7, 5, 5),  # function, node, attribute, tensor
    ],
)
def test_tensors_are_found_wherever_they_hide(path: tuple[int, ...]) -> None:
    for tensor, expected in ((INSIDE, False), (OUTSIDE, True)):
        data = tensor
        for number in reversed(path):
            data = message(number, data)
        assert refers_to_files(data) is expected


@pytest.mark.parametrize("data", [b"\xff" * 20, b"\x3a\x05\x00", b"\x0b", b"\x80"])
def test_what_is_not_protobuf(data: bytes) -> None:
    with pytest.raises(ModelError, match="not an ONNX file"):
        refers_to_files(data)


@given(st.binary(max_size=200))
def test_any_bytes_end_in_an_answer_or_an_error(data: bytes) -> None:
    with suppress(ModelError):
        assert refers_to_files(data) in (True, False)
