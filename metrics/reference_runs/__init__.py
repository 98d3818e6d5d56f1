"""Boxes of runs and logs as the benchmarks' own files would have them."""
