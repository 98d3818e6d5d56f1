"""Depth from two cameras side by side."""
