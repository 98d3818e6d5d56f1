"""Early fusion in 3D: `fuse.py` finds objects in one cloud of all sensors, which `cloud.py` merges."""
