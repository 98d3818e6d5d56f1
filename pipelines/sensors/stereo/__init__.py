"""Stereo."""
