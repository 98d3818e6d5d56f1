"""Formats of boxes and rigs of others: `open` reads boxes, `export` writes them, `rig_files` reads calibration."""
