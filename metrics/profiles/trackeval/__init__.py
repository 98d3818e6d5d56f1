"""Trackeval."""
