"""Early fusion in 3D: one cloud of all sensors, clustered, with semantics from images."""
