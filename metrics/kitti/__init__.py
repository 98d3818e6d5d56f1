"""KITTI's object benchmark, and 3D tracking on KITTI as AB3DMOT counts it."""
