"""Importer of KITTI: raw drives, tracking and object benchmarks."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.imports.wish import ImportWish
from fbench.replay.protocols import Recording


class Kitti:
    """See `Importer`."""

    def names(self, source: Path) -> Sequence[str]:
        """See `Importer`."""
        raise LogError(f"{source}: not written yet")

    def recordings(self, source: Path, wish: ImportWish) -> Iterator[Recording]:
        """See `Importer`."""
        raise LogError(f"{source}: not written yet")
