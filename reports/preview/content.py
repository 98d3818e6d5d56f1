"""Content of a contact sheet, and its picture files."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.images import Pixels


@dataclass(frozen=True)
class Shown:
    """One picture."""

    file: str
    size_wh: tuple[int, int]
    caption: str
    alt: str


@dataclass(frozen=True)
class Verdict:
    """One line about calibration, time, Doppler or truth."""

    about: str
    """Which sensors."""
    what: str
    """`alignment`, `stereo`, `time`, `doppler` or `truth`."""
    text: str
    is_bad: bool


@dataclass(frozen=True)
class FrameContent:
    """The pictures of one frame."""

    index: int
    head: str
    pictures: Sequence[Shown]


@dataclass(frozen=True)
class SensorRow:
    """One line of the table of sensors."""

    name: str
    kind: str
    messages: int
    missing: str
    mounted: str
    camera: str
    shift: str
    delay: str
    problem: str


@dataclass(frozen=True)
class Content:
    """The whole sheet."""

    name: str
    facts: Sequence[tuple[str, str]]
    sensors: Sequence[SensorRow]
    verdicts: Sequence[Verdict]
    gaps: Sequence[str]
    """What can't be shown, and why."""
    measured: Sequence[Shown]
    """Rig, times, Doppler and edges: one picture each for the whole log."""
    frames: Sequence[FrameContent] = field(default_factory=tuple)

    @property
    def pictures(self) -> Sequence[Shown]:
        """All of them, in the order of the sheet."""
        return [*self.measured, *(picture for frame in self.frames for picture in frame.pictures)]


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
