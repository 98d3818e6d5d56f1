"""Conditions of LiDARs."""
