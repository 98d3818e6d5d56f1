"""Points of any sensor: merged in body coordinates, ground, clustering, and vehicles completed from what is seen."""
