"""Detectors for real images by name: what there is, how it is fetched, where it is kept."""
