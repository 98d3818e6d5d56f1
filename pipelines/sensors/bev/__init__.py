"""Detection in a bird's-eye view by a network: its input in `grid.py`, its output in `decoding.py`, `detector.py`."""
