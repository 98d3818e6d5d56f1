"""Robustness: what conditions cost a pipeline."""
