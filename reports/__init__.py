"""Reports: turn results into files and compute nothing."""
