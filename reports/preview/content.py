"""What a contact sheet shows."""

from collections.abc import Sequence
from dataclasses import dataclass, field


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
