"""Digests: blake2b over a canonical encoding, so that equal data have equal digests everywhere.

Large arrays and images go in as their XXH3-128, which costs a thirtieth: digests tell accidents, not attacks.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np
import xxhash

from fbench.replay.data.arrays import DIGESTED, Array

_SIZE = 16
_BULK = 4096  # From so many bytes on XXH3-128 is taken first
START = "0" * 2 * _SIZE  # First link of every chain


class Digest:
    """A blake2b-128 over values, each encoded with its type and length."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(b"fbench2", digest_size=_SIZE)

    def add(self, value: object) -> None:
        """Append a value: `None`, bool, int, float, str, bytes, array, dataclass, or mapping and sequence of these.
        Raises TypeError for any other type. Fields of dataclasses that others determine are left out.
        """
        if is_dataclass(value) and not isinstance(value, type):
            self._head("dataclass", type(value).__name__)
            names = sorted(f.name for f in fields(value) if f.metadata.get(DIGESTED, True))
            self.add({name: getattr(value, name) for name in names})
        elif isinstance(value, np.ndarray):
            self._add_array(value)
        elif isinstance(value, Mapping):
            self._head("mapping", str(len(value)))
            for key in sorted(value):
                self.add(key)
                self.add(value[key])
        elif isinstance(value, list | tuple):
            self._head("sequence", str(len(value)))
            for item in value:
                self.add(item)
        else:
            self._add_scalar(value)

    def hex(self) -> str:
        """The digest of everything added so far."""
        return self._hash.hexdigest()

    def _head(self, kind: str, text: str) -> None:
        data = text.encode("utf-8", "surrogatepass")
        self._hash.update(f"{kind}:{len(data)}:".encode())
        self._hash.update(data)

    def _add_scalar(self, value: object) -> None:
        if isinstance(value, bytes):
            self._hash.update(f"bytes:{len(value)}:".encode())
            self._add_bytes(value)
        elif isinstance(value, float):
            self._head("float", (value + 0.0).hex())
        elif value is None or isinstance(value, bool | int | str):
            self._head(type(value).__name__, str(value))
        else:
            raise TypeError(f"{type(value).__name__} has no canonical encoding")

    def _add_array(self, array: Array) -> None:
        if array.dtype.kind == "U":
            self.add(["text", *array.tolist()])
            return
        if array.dtype.kind == "f":  # one NaN and one zero
            array = np.asarray(array + array.dtype.type(0))
            if (odd := np.isnan(array)).any():
                array[odd] = np.nan
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        self._head("array", f"{little.dtype.str}{array.shape}")
        self._add_bytes(little.data.cast("B") if little.size else b"")

    def _add_bytes(self, data: bytes | memoryview) -> None:
        self._hash.update(data if len(data) < _BULK else xxhash.xxh3_128_digest(data))


def digest(value: object) -> str:
    """Return the digest of one value."""
    result = Digest()
    result.add(value)
    return result.hex()


def link(previous: str, current: str) -> str:
    """Return the next link of a chain of digests."""
    return hashlib.blake2b(bytes.fromhex(previous) + bytes.fromhex(current), digest_size=_SIZE).hexdigest()
