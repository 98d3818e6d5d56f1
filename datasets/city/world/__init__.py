"""Road networks: lanes, signals, regions, and all that stands."""
