"""Files of datasets: find, read and check them; sensors from matrices; lines of an import's summary."""

import re
import struct
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fbench.replay.contracts.errors import DecodeError, LimitError, LogError, first_wrong
from fbench.replay.contracts.importing import FrameRange, read_bytes
from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.images import MAX_PIXELS, read_size, sniff_format
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import Kind, Mount
from fbench.replay.geometry.transforms import quaternion
from fbench.replay.logs.containers.limits import crc32

T = TypeVar("T")
BODY_T_OPTICAL: Float64 = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from axes right, down, forward, as cameras have them, to those of bodies: forward, left, up."""
_ENDS = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_ALL = FrameRange()


def format_list(things: Iterable[object], most: int) -> str:
    """Return things with commas between, the first ones of many: `1, 2 and 3 more`."""
    texts = [str(thing) for thing in things]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def find_runs(numbers: Iterable[int]) -> list[range]:
    """Return the runs of numbers, which ascend."""
    found: list[range] = []
    for number in numbers:
        if found and number == found[-1].stop:
            found[-1] = range(found[-1].start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


def format_runs(runs: Iterable[range], most: int) -> str:
    """Return runs by their first and last numbers: `3, 177 to 180 and 2 more`."""
    return format_list((f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs), most)


def format_counts(counts: Counter[str]) -> str:
    """Return counts by name, the largest first, equal ones by name: `Car 3, Van 1`."""
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {num}" for name, num in ranked)


def mount_of(kind: Kind, body_T_sensor: Float64) -> Mount:
    """Return where a sensor is, by its pose (4, 4), whose rotation is made orthonormal."""
    return Mount(kind, body_T_sensor[:3, 3], quaternion(body_T_sensor[:3, :3]))


def is_rotation(R: Float64, tolerance: float = 1e-3) -> bool:
    """Tell whether a matrix (3, 3) is orthonormal up to a tolerance, as files round, and doesn't mirror."""
    # Not by BLAS, whose result depends on the machine; NaN isn't within the tolerance.
    with np.errstate(over="ignore", invalid="ignore"):
        gram = (R[:, :, None] * R[:, None, :]).sum(axis=0)
    return bool(np.abs(gram - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0)


def is_pinhole(K: Float64) -> bool:
    """Tell whether a matrix (3, 3) is of the form fx s cx / 0 fy cy / 0 0 1, with fx and fy above 0."""
    return bool(K[0, 0] > 0 and K[1, 1] > 0 and K[2, 2] == 1 and not np.tril(K, -1).any())


def read_floats(path: Path, num_columns: int) -> Float32:
    """Rows (N, `num_columns`) of little-endian float32. Raises LogError for unreadable, empty and truncated files."""
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
    """Return an image as it is encoded; `log_ns` is its stamp unless given. Raises LogError where it isn't an image, is
    truncated, or isn't of the size `size_wh` that its camera is calibrated for.
    """
    data = read_bytes(path)
    try:
        encoding, size = sniff_format(data), read_size(data)
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


def entries(folder: Path) -> list[Path]:
    """What is in a folder, by name; nothing where there is none. Raises LogError where it can't be read."""
    try:
        return sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise LogError(f"{folder}: {error.strerror}") from error


def find_numbered(folder: Path, suffixes: tuple[str, ...], digits: int, frames: FrameRange = _ALL) -> dict[int, Path]:
    """Return files named by numbers of so many digits, ascending; none without the folder. LogError: can't be read."""
    found = {int(p.stem): p for p in entries(folder) if p.suffix in suffixes and is_number(p.stem, digits)}
    return {number: found[number] for number in sorted(found) if number in frames}


def is_number(text: str, digits: int) -> bool:
    """Tell whether a text is a number of so many digits."""
    return re.fullmatch(f"[0-9]{{{digits}}}", text) is not None


def read_json(path: Path, model: type[T]) -> T:
    """Read JSON. Raises LogError naming file and field, where it can't be read or isn't as the model says."""
    try:
        return TypeAdapter(model).validate_json(read_bytes(path))
    except ValidationError as error:
        raise LogError(f"{path}: {first_wrong(error)}") from error
