"""Scores of run folders: `detection` and `tracking` are the metrics, `combine` adds runs, `spaces` selects boxes."""
