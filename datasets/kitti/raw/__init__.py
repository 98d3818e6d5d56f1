"""KITTI's raw drives."""

from fbench.datasets.kitti.raw.recording import names, recording

__all__ = ["names", "recording"]
