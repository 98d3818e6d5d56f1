"""Reading the files of datasets; whatever is wrong with one is told in a line that names it."""

import stat
import struct
from pathlib import Path

import numpy as np

from fbench.replay.arrays import Float32
from fbench.replay.checksums import crc32
from fbench.replay.data import Image
from fbench.replay.errors import DecodeError, LimitError, LogError
from fbench.replay.images import MAX_PIXELS, encoded_format, encoded_size

MAX_BYTES = 112 * 2**20
"""No file of a dataset that becomes one message is larger."""
_ENDS = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}


def require_folder(path: Path) -> None:
    """Refuse what isn't a folder.

    Raises:
        LogError: saying what it is.
    """
    if not path.is_dir():
        raise LogError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}")


def require_file(path: Path) -> None:
    """Refuse what isn't a file: pipes and devices never end, or never begin.

    Raises:
        LogError: saying so.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {error.strerror if isinstance(error, OSError) else error}") from error
    if not stat.S_ISREG(mode):
        raise LogError(f"{path}: {'Is a directory' if stat.S_ISDIR(mode) else 'a pipe or device, expected a file'}")


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a file.

    Raises:
        LogError: where it can't be read.
        LimitError: where it is larger than `limit` [byte].
    """
    require_file(path)
    try:
        if (size := path.stat().st_size) > limit:
            raise LimitError(f"{path}: {size} bytes, more than {limit}")
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error


def read_text(path: Path, limit: int = MAX_BYTES) -> str:
    """Return the content of a text file.

    Raises:
        LogError: where it can't be read, or isn't UTF-8.
        LimitError: where it is larger than `limit` [byte].
    """
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason} at byte {error.start})") from error


def read_floats(path: Path, num_columns: int) -> Float32:
    """Return rows (N, `num_columns`) of a file of little-endian float32.

    Raises:
        LogError: where it can't be read, is empty, or ends within a row.
    """
    data = read_bytes(path)
    if not data:
        raise LogError(f"{path}: is empty, is it truncated?")
    if len(data) % (4 * num_columns):
        raise LogError(f"{path}: {len(data)} bytes aren't whole rows of {num_columns} float32, is it truncated?")
    return np.frombuffer(data, "<f4").astype(np.float32, copy=False).reshape(-1, num_columns)


def read_image(
    path: Path,
    sensor: str,
    stamp_ns: int,
    size_wh: tuple[int, int] | None = None,
    log_ns: int | None = None,
    frame_number: int | None = None,
) -> Image:
    """Return an image as it is encoded; `log_ns` is its stamp unless given.

    Raises:
        LogError: where it isn't an image, is truncated, or isn't of the size `size_wh` that its camera is calibrated
            for.
    """
    data = read_bytes(path)
    try:
        encoding, size = encoded_format(data), encoded_size(data)
    except DecodeError as error:
        raise LogError(f"{path}: {error}") from error
    # Some cameras pad their files with zeros.
    if encoding in _ENDS and not data.rstrip(b"\0").endswith(_ENDS[encoding]):
        raise LogError(f"{path}: the image has no end, is it truncated?")
    if encoding == "png" and not _is_whole_png(data):
        raise LogError(f"{path}: the image is damaged, a checksum in it is wrong")
    if not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise LimitError(f"{path}: {size[0]}x{size[1]} px, expected 1 to {MAX_PIXELS} pixels")
    if size_wh is not None and size != size_wh:
        raise LogError(f"{path}: {size[0]}x{size[1]} px, expected {size_wh[0]}x{size_wh[1]} as the calibration says")
    return Image(sensor, stamp_ns, stamp_ns if log_ns is None else log_ns, data, encoding, size, frame_number)


def _is_whole_png(data: bytes) -> bool:
    """Whether chunks follow one another up to the last one, and have the checksums that they say: ISO/IEC 15948, 5.3.

    Decoders tell of damage on stderr, each in its own way.
    """
    at, view = 8, memoryview(data)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data) or struct.unpack_from(">I", data, end)[0] != crc32(view[at + 4 : end]):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False
