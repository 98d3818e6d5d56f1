"""Cameras: shading, weather, lens and sensor."""
