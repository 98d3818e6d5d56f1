"""Definition of each metric: TOML files, read by `catalog`."""
