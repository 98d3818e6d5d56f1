"""Taking the one big field out of a Protobuf message without copying it.

https://protobuf.dev/programming-guides/encoding: a message is a sequence of tags (field number and wire type) and
values. Parsing clouds and images whole would copy them once more.
"""

from fbench.replay.errors import DecodeError

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5
_FIXED = {_FIXED64: 8, _FIXED32: 4}


def split(payload: memoryview, number: int) -> tuple[bytes, memoryview]:
    """Return the message without the bytes field `number`, and that field's value (the last one, as Protobuf has it).

    Raises:
        DecodeError: where the message is cut off or not Protobuf.
    """
    head: list[memoryview] = []
    value = payload[:0]
    kept, at, end = 0, 0, len(payload)
    while at < end:
        start = at
        tag, at = _varint(payload, at)
        kind = tag & 7
        if kind == _LENGTH:
            length, at = _varint(payload, at)
            if length > end - at:
                raise DecodeError(f"field {tag >> 3} of {length} bytes is cut off")
            if tag >> 3 == number:
                head.append(payload[kept:start])
                value = payload[at : at + length]
                kept = at + length
            at += length
        elif kind == _VARINT:
            _, at = _varint(payload, at)
        elif kind in _FIXED:
            at += _FIXED[kind]
        else:
            raise DecodeError(f"field {tag >> 3} has unknown wire type {kind}")
    if at > end:
        raise DecodeError("message is cut off")
    return b"".join([*head, payload[kept:]]), value


def _varint(payload: memoryview, at: int) -> tuple[int, int]:
    """Value at `at`, and where it ends."""
    value, shift = 0, 0
    while at < len(payload) and shift < 64:
        byte = payload[at]
        value |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return value, at
        shift += 7
    raise DecodeError("message is cut off")
