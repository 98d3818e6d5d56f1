"""Detection by LiDAR and radar in images: `stage.py`, with the objects that points show in `objects.py`."""
