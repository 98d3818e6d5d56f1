"""Overlays: results of a run beside its log in Foxglove and Lichtblick."""
