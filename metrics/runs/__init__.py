"""Runs as sequences that can be scored."""
