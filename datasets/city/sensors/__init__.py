"""LiDAR and radar."""
