"""Damage to valid files: flipped bits, cuts, repeated and foreign pieces, each from a seed."""

from collections.abc import Callable, Iterator

import numpy as np

from fbench.replay.contracts.errors import FbenchError

FOREIGN = (
    b"\x00", b"\xff", b"9" * 40, b"1e999", b"NaN", b"-", b"[" * 50, b"{" * 50, b"\\ud800", b"\x1b[31m", b'"', b"\n",
    b",", b"null", b"../..", b"\xef\xbb\xbf", b"9" * 5000, b"x" * 2000, b"inf", b"<!DOCTYPE a>", b"&a;", b"0", b"-1",
)  # fmt: skip


def mutated(content: bytes, num: int, seed: int) -> Iterator[bytes]:
    """Yield `num` damaged versions of a file."""
    for i in range(num):
        random = np.random.Generator(np.random.Philox(key=seed, counter=i))
        data = bytearray(content)
        for _ in range(int(random.integers(1, 4))):
            _damage(data, random)
        yield bytes(data)


def _damage(data: bytearray, random: np.random.Generator) -> None:
    at, length = int(random.integers(0, len(data) + 1)), int(random.integers(1, 30))
    kind = int(random.integers(0, 5))
    if kind == 0 and at < len(data):
        data[at] ^= 1 << int(random.integers(0, 8))
    elif kind == 1:
        del data[at:]
    elif kind == 2:
        del data[at : at + length]
    elif kind == 3:
        data[at:at] = data[at : at + length] * int(random.integers(1, 4))
    else:
        data[at:at] = FOREIGN[int(random.integers(0, len(FOREIGN)))]


def complaint(call: Callable[[], object]) -> str:
    """Return how a call is refused, empty where it isn't; anything but fbench's own errors comes through."""
    try:
        call()
    except FbenchError as error:
        return str(error)
    return ""
