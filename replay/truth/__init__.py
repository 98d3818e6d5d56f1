"""Ground truth of a run: which frame it belongs to, and where its objects are at that frame's instant."""
