"""Matching, similarity, orders, slices, exact sums and bootstrap: what all metrics share."""
