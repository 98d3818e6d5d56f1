"""The detection and tracking benchmarks of nuScenes."""
