"""KITTI's raw drives."""

from fbench.datasets.kitti.raw.files import find_drives
from fbench.datasets.kitti.raw.recording import recording

__all__ = ["find_drives", "recording"]
