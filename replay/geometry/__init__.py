"""Transforms, camera projection, boxes and their overlap: shared by all folders."""
