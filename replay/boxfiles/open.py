"""Opening a file or folder of boxes, whatever form it is in."""

from collections.abc import Iterator, Mapping
from typing import Protocol

from fbench.replay.data import Truth
from fbench.replay.errors import ConfigError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource


class BoxFile(Protocol):
    """Boxes of a file."""

    @property
    def format(self) -> str:
        """One of `FORMATS`."""
        ...

    def truths(self) -> Iterator[Truth]:
        """In the order of stamps or frames."""
        ...

    def labels(self) -> Mapping[str, int]:
        """Classes as the source names them, with the number of their boxes."""
        ...


def open_boxes(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> BoxFile:
    """Open a file or folder of boxes."""
    raise ConfigError(f"{source.path}: not a known form of boxes")
