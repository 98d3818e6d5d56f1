"""Fusion of what camera, LiDAR and radar see into one set of 3D boxes."""
