"""Hot loops of the metrics, compiled on first use."""
