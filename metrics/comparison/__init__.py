"""Comparison of runs and suites: what may be compared, intervals, verdicts, and what changed object by object."""
