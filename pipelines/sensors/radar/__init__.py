"""Radar."""
