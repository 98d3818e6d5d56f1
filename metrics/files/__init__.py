"""Truth and results of other systems, from files."""
