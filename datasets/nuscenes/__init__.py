"""nuScenes."""

from fbench.datasets.nuscenes.importer import NuScenes, NuScenesParams

__all__ = ["NuScenes", "NuScenesParams"]
