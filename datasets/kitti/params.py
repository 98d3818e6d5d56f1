"""What can be chosen about an import of KITTI."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class KittiParams:
    """Parameters of `Kitti`."""

    detections: Path | None = None
    """Folder with another system's results, `NNNN.txt` for each sequence of the tracking benchmark or `FFFFFF.txt` for
    each frame of the object benchmark; they become recorded results."""
