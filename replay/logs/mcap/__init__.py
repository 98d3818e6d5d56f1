"""MCAP files: reading with every checksum verified, and writing."""
