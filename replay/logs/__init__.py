"""Containers (MCAP) and message codecs (Foxglove)."""
