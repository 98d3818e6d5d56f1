"""Detection by LiDAR: in `stage.py` by clusters (`clusters.py`, classified in `classification.py`) or a network."""
