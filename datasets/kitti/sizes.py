"""Sizes of KITTI's rectified images."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from fbench.replay.boxfiles.rows import Labelled
from fbench.replay.data import Float64
from fbench.replay.errors import DecodeError, LogError
from fbench.replay.images import encoded_size
from fbench.replay.imports.files import read_bytes

Size = tuple[int, int]
_BY_FOCAL_LENGTH: Mapping[float, tuple[str, Size]] = {
    721.5377: ("2011_09_26", (1242, 375)),
    707.0493: ("2011_09_28", (1224, 370)),
    718.3351: ("2011_09_29", (1238, 374)),
    707.0912: ("2011_09_30", (1226, 370)),
    718.856: ("2011_10_03", (1241, 376)),
}
"""Day of recording and size [px], by the focal length [px] of the rectified cameras, which is that of the day."""
_MAX_SIDE_PX = 2**16


def known_size(P: Float64) -> tuple[str, Size] | None:
    """Return the day that a projection (3, 4) belongs to, and the images' size [px] on it; `None` where it is none of
    KITTI's.
    """
    return _BY_FOCAL_LENGTH.get(round(float(P[0, 0]), 4))


def size_without_images(P: Float64, objects: Iterable[Labelled]) -> tuple[Size, str]:
    """Return a size [px] for the camera of a projection (3, 4) that there are no images of, and how it is known.

    It is that of the day; else that of the smallest image that holds all labelled boxes; without any, that of the image
    whose middle is the principal point.
    """
    known = known_size(P)
    if known is not None:
        day, size_wh = known
        return size_wh, f"without images: that of {day}, the day of recording by its focal length"
    corners = [row.flat.xyxy_px[2:] for row in objects if row.flat is not None]
    if corners:
        right, bottom = (max(values) for values in zip(*corners, strict=True))
        return _size(right + 1, bottom + 1), "without images: the smallest that holds all labelled boxes"
    return _size(2 * P[0, 2], 2 * P[1, 2]), "without images: twice the principal point"


def _size(width: float, height: float) -> Size:
    return min(max(math.ceil(width), 1), _MAX_SIDE_PX), min(max(math.ceil(height), 1), _MAX_SIDE_PX)


def first_size(paths: Iterable[Path]) -> Size | None:
    """Return the size [px] of the first image whose header can be read; `None` where there is none."""
    for path in paths:
        try:
            return encoded_size(read_bytes(path))
        except (LogError, DecodeError):
            continue  # whoever reads it for its pixels tells what is wrong with it
    return None
