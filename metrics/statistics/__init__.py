"""Sufficient statistics: exact sums, and resampling."""
