"""Matrices of replays: many cells, few processes, nothing done twice."""
