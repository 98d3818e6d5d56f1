"""KITTI: raw drives, tracking and object benchmarks."""

from fbench.datasets.kitti.importer import Kitti

__all__ = ["Kitti"]
