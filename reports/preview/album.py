"""Picture files."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fbench.replay.errors import DecodeError
from fbench.replay.images import Pixels
from fbench.reports.preview.content import Shown

_PNG_LEVEL = 6


class Album:
    """Writes pictures into a folder, under names that are safe whatever sensors are called.

    Args:
        folder: An existing one.
        names: All sensors; a sensor's number in their order keeps file names apart.
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self._folder, self._names = folder, list(names)

    def add(self, stem: str, pixels: Pixels, caption: str, alt: str) -> Shown:
        """Write one picture."""
        import cv2

        ok, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])
        if not ok:
            raise DecodeError(f"picture {stem} of shape {pixels.shape} can't be encoded")
        (self._folder / f"{stem}.png").write_bytes(np.asarray(data).tobytes())
        return Shown(f"{stem}.png", (pixels.shape[1], pixels.shape[0]), caption, alt)

    def stem(self, sensor: str) -> str:
        """Part of a file name for a sensor: its number, and what is safe of its name."""
        return f"{self._names.index(sensor)}-{re.sub(r'[^A-Za-z0-9_]+', '-', sensor)[:40]}".rstrip("-")
