"""nuScenes."""

from fbench.datasets.nuscenes.importer import NuScenes

__all__ = ["NuScenes"]
