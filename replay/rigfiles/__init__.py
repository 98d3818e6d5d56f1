"""Calibration from files of other programs: TOML, URDF, Kalibr, ROS camera_info."""
