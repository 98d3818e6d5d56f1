"""Late fusion in 3D: `fuse.py` merges what sensors detect, by `association.py`, `place.py` and `existence.py`."""
