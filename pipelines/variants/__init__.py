"""The built-in pipelines, one short composition each: late3d, late2d, early3d and early2d in `early_late.py`, others in
`camera2d.py`, `lidar.py`, `radar.py`, `stereo3d.py`, `recorded.py`; `thesis/` holds variants of them as TOML files."""
