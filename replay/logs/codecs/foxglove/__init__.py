"""Foxglove."""
