"""Detectors by name (`weights.py`), and the network of the city's detector with its training."""
