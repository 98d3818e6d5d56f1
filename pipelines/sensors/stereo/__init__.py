"""Depth by stereo: `depth.py`, and vehicles in it: `stage.py`."""
