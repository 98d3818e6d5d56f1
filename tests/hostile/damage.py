"""Damage and edits of valid content, each from a seed: bytes, numbers, tokens of a text, fields of protobuf."""

import re

import numpy as np

Random = np.random.Generator
FOREIGN = (
    b"\x00", b"\xff", b"9" * 40, b"1e999", b"NaN", b"-", b"[" * 50, b"{" * 50, b"\\ud800", b"\x1b[31m", b'"', b"\n",
    b",", b"null", b"../..", b"\xef\xbb\xbf", b"9" * 5000, b"x" * 2000, b"inf", b"<!DOCTYPE a>", b"&a;", b"0", b"-1",
)  # fmt: skip
TOKENS = (
    b"0", b"-1", b"1e308", b"-1e-320", b"1e999", b"nan", b"-inf", b"NaN", b"18446744073709551616", b"9" * 400, b"0x7",
    b"1_000", b"null", b"true", b'""', b'"\\ud800"', b'"../../etc"', b"[]", b"{}", b"[[[[[[]]]]]]", b"'", b"x" * 3000,
    "\u202eé".encode(), b"2020-01-01", b"1e5", b"0.1.2", b" ", b"-0.0", b"4294967296", b"", b"~",
)  # fmt: skip
NUMBERS = (
    b"0", b"-1", b"1e308", b"-1e-320", b"1e999", b"nan", b"-inf", b"NaN", b"18446744073709551616", b"1e5", b"-0.0",
    b"4294967296", b"2147483647", b"0.5", b"1e-9", b"9" * 400, b"null", b"7", b"true",
)  # fmt: skip
_NUMBER = re.compile(rb"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?(?![\w.])")
_TOKEN = re.compile(rb"[\w.+-]+|\"[^\"\n]*\"|\S")
EXTREMES = (
    0, 1, 2, 3, 127, 128, 255, 2**15, 2**16 - 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**63 - 1, 2**63,
    2**64 - 1, 0x7F800000, 0x7FC00000, 0xFF800000, 0x7FF0000000000000, 0x7FF8000000000000, 0x7FEFFFFFFFFFFFFF,
)  # fmt: skip
"""Lengths, counts, stamps, and numbers that aren't finite, as float32 and as float64."""


def damage(content: bytes, random: Random) -> bytes:
    """Flip, cut, delete, repeat, blank or insert in one to three places."""
    data = bytearray(content)
    for _ in range(int(random.integers(1, 4))):
        at, length = int(random.integers(0, len(data) + 1)), int(random.integers(1, 30))
        match int(random.integers(0, 7)):
            case 0 | 1 if at < len(data):
                data[at] ^= 1 << int(random.integers(0, 8))
            case 2:
                del data[at:]
            case 3:
                del data[at : at + length]
            case 4:
                data[at:at] = data[at : at + length] * int(random.integers(1, 4))
            case 5:  # as a copy that stopped or a bad sector leaves it
                length = min(len(data) - at, length * int(random.integers(1, 40)))
                data[at : at + length] = bytes(length)
            case _:
                data[at:at] = FOREIGN[int(random.integers(0, len(FOREIGN)))]
    return bytes(data)


def edit_number(content: bytes, random: Random) -> bytes:
    """Overwrite a number of 1, 2, 4 or 8 bytes in place, often an extreme one; the length stays."""
    data, size = bytearray(content), 1 << int(random.integers(0, 4))
    if len(data) < size:
        return damage(content, random)
    at = int(random.integers(0, len(data) - size + 1))
    value = EXTREMES[int(random.integers(0, len(EXTREMES)))] if random.random() < 0.8 else int(random.integers(2**62))
    data[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, "little")
    return bytes(data)


def edit_text(content: bytes, random: Random) -> bytes:
    """Replace, delete, double or swap words, texts and signs, one to three times; half the time numbers alone."""
    data, numbers = content, random.random() < 0.5
    for _ in range(int(random.integers(1, 4))):
        found = list((_NUMBER if numbers else _TOKEN).finditer(data))
        if not found:
            return data
        one, other = (found[int(i)] for i in random.integers(0, len(found), 2))
        odd = (NUMBERS if numbers else TOKENS)[int(random.integers(len(NUMBERS if numbers else TOKENS)))]
        new = [odd, b"", one[0] * 2, other[0], one[0] + b" " + other[0]]
        chosen = new[0] if numbers else new[int(random.choice(5, p=[0.6, 0.1, 0.1, 0.1, 0.1]))]
        data = data[: one.start()] + chosen + data[one.end() :]
    return data


def edit_proto(content: bytes, random: Random, depth: int = 0) -> bytes:
    """Change one field somewhere in a protobuf message and keep all lengths right; see
    https://protobuf.dev/programming-guides/encoding. Bytes that look like a message are taken for one, half the time.
    """
    fields = split_proto(content)
    if not fields:
        return edit_number(content, random) if content else b"\x08\x01"
    i = int(random.integers(0, len(fields)))
    number, wire, value = fields[i]
    match int(random.integers(0, 6)):
        case 0:
            del fields[i]
        case 1:
            fields[i:i] = [fields[i]] * int(random.choice([1, 1, 40]))
        case 2:
            number = int(random.choice([*range(1, 12), number + 1]))
            fields[i] = (number, wire, value)
        case _ if wire == 2 and depth < 8 and random.random() < 0.7 and split_proto(value):
            fields[i] = (number, wire, edit_proto(value, random, depth + 1))
        case 3 if wire == 2:
            fields[i] = (number, wire, random.choice([b"", value * 2, value[:-1], *FOREIGN]))
        case _:
            new = varint(EXTREMES[int(random.integers(0, len(EXTREMES)))]) if wire == 0 else edit_number(value, random)
            fields[i] = (number, wire, new)
    return b"".join(join_proto(*field) for field in fields)


def split_proto(content: bytes) -> list[tuple[int, int, bytes]]:
    """Number, wire type and value of each field of a protobuf message; empty where it isn't one."""
    fields, at = [], 0
    try:
        while at < len(content):
            key, at = _read_varint(content, at)
            start, wire = at, key & 7
            if wire == 0:
                at = _read_varint(content, at)[1]
            else:
                size, at = _read_varint(content, at) if wire == 2 else ({1: 8, 5: 4}[wire], at)
                start, at = at, at + size
            if at > len(content) or key < 8:
                return []
            fields.append((key >> 3, wire, content[start:at]))
    except (KeyError, IndexError):
        return []
    return fields


def join_proto(number: int, wire: int, value: bytes) -> bytes:
    """Encode one field."""
    return varint(number << 3 | wire) + (varint(len(value)) if wire == 2 else b"") + value


def varint(value: int) -> bytes:
    """Encode a number of up to 64 bits in as many bytes as it needs."""
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*parts, value])


def _read_varint(content: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        value |= (content[at] & 0x7F) << shift
        at += 1
        if content[at - 1] < 0x80:
            return value, at
    raise IndexError
