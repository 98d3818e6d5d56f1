"""The built-in pipelines, one short composition each: early2d and early3d in `early.py`, late2d and late3d in `late.py`
(`all_sensors.py` is what they share); others in `camera2d.py`, `lidar.py`, `radar.py`, `stereo3d.py`, `learned3d.py`,
`recorded.py`; `thesis/` holds variants of them as TOML files."""
