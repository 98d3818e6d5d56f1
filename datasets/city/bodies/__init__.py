"""Meshes of road users: vehicles, riders, pedestrians."""
