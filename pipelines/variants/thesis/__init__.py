"""Configurations of the thesis as variants of `plain2d` and `plain3d`, one TOML file each."""
