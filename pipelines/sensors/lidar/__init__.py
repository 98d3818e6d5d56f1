"""Detection by LiDAR: `lidar.py`, with the classification of clusters in `classification.py`."""
