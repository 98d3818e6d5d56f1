"""Structs in Thrift's compact protocol, in which Parquet describes itself: page headers and footers.

pyarrow reads them too, but shows a page's header to nobody, and ends the process where a footer's numbers contradict
each other (as of version 26).
"""

from typing import TypeAlias

_MAX_DEPTH = 16
_TRUE, _FALSE, _BYTE, _STRUCT = 1, 2, 3, 12

Value: TypeAlias = "int | bytes | Struct | list[Struct] | None"
Struct: TypeAlias = "dict[int, Value]"


class DamageError(Exception):
    """Bytes that aren't what they should be, with the reason."""


def read_struct(data: memoryview, at: int = 0, depth: int = 0) -> tuple[Struct, int]:
    """Read a struct; returns its fields by id, and where it ends. Of lists only those of structs are kept.

    Raises:
        DamageError: where there is none.
    """
    if depth > _MAX_DEPTH:
        raise DamageError("structs are nested too deeply")
    fields: Struct = {}
    key = 0
    try:
        while head := data[at]:
            at += 1
            if head >> 4:
                key += head >> 4
            else:
                key, at = _zigzag(data, at)
            fields[key], at = _read_value(data, at, head & 15, depth)
    except IndexError:
        raise DamageError("a struct is cut off") from None
    return fields, at + 1


def number(fields: Struct, key: int) -> int:
    """Return a number that isn't negative.

    Raises:
        DamageError: where it isn't there.
    """
    value = fields.get(key)
    if not isinstance(value, int) or value < 0:
        raise DamageError("a number is missing or negative")
    return value


def struct(fields: Struct, key: int) -> Struct:
    """Return a struct inside.

    Raises:
        DamageError: where it isn't there.
    """
    value = fields.get(key)
    if not isinstance(value, dict):
        raise DamageError("a struct is missing")
    return value


def structs(fields: Struct, key: int) -> list[Struct]:
    """Return a list of structs.

    Raises:
        DamageError: where it isn't there.
    """
    value = fields.get(key)
    if not isinstance(value, list):
        raise DamageError("a list is missing")
    return value


def _read_value(data: memoryview, at: int, kind: int, depth: int) -> tuple[Value, int]:
    match kind:
        case 1 | 2:  # the value of a flag is in its type
            return kind == _TRUE, at
        case 3:
            return data[at], at + 1
        case 4 | 5 | 6:
            return _zigzag(data, at)
        case 7:
            return None, at + 8
        case 8:
            length, at = _varint(data, at)
            return bytes(data[at : at + length]), at + length
        case 9 | 10:
            return _read_list(data, at, depth)
        case 12:
            return read_struct(data, at, depth + 1)
        case _:
            raise DamageError(f"a field has the unknown type {kind}")


def _read_list(data: memoryview, at: int, depth: int) -> tuple[Value, int]:
    """All of a list of structs; of others the first item, which for the path of a column is its name."""
    kind, num = data[at] & 15, data[at] >> 4
    at += 1
    if num == 15:
        num, at = _varint(data, at)
    found: list[Struct] = []
    first: Value = None
    kind = _BYTE if kind in (_TRUE, _FALSE) else kind  # flags in lists have a byte each
    for i in range(num):
        value, at = _read_value(data, at, kind, depth)
        if isinstance(value, dict):
            found.append(value)
        elif i == 0:
            first = value
    return found if kind == _STRUCT else first, at


def _zigzag(data: memoryview, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise DamageError("a number is too long")
