"""Finds out whether an ONNX file keeps tensors in other files, before any library opens it.

Loading such a model would read paths that the file names. Walks the protobuf wire format: numbers of fields are
those of onnx.proto (ONNX, Apache-2.0).
"""

from collections.abc import Iterator, Mapping

from fbench.replay.errors import ModelError

_DATA_LOCATION, _EXTERNAL = 14, 1
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
    """Tell whether any tensor of the model is stored outside of `data`.

    Raises:
        ModelError: where `data` isn't protobuf.
    """
    todo = [("model", memoryview(data))]
    while todo:
        kind, message = todo.pop()
        for number, value in _fields(message):
            if kind == "tensor" and number == _DATA_LOCATION and value == _EXTERNAL:
                return True
            child = _CHILDREN[kind].get(number)
            if child and isinstance(value, memoryview):
                todo.append((child, value))
    return False


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
