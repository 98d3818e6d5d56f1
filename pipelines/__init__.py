"""Pipelines: stages, their kernels, and one small file that composes each variant."""
