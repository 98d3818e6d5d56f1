"""Telling what a file is from its first bytes, for errors that help."""

from typing import BinaryIO

_MAGICS = (
    (b"PAR1", "Parquet; give the folder that it belongs to"),
    (b"\x1f\x8b", "gzip"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x28\xb5\x2f\xfd", "zstd; decompress it first"),
    (b"\x04\x22\x4d\x18", "lz4; decompress it first"),
    (b"\x89HDF\r\n", "HDF5"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x89MCAP", "MCAP of another version"),
)


def looks_like(file: BinaryIO) -> str:
    """Guess what a file is."""
    file.seek(0)
    start = file.read(512)
    if not start:
        return "an empty file"
    known = next((name for magic, name in _MAGICS if start.startswith(magic)), None)
    if known is not None:
        return known
    if not _is_text(start):
        return "unknown binary data"
    return "JSON" if start.lstrip()[:1] in (b"{", b"[") else "text"


def _is_text(start: bytes) -> bool:
    try:
        text = start[: start.rfind(b"\n") + 1 or None].decode()
    except UnicodeDecodeError:
        return False
    return all(c.isprintable() or c.isspace() for c in text)
