"""Boxes from files: ground truth, or the results of other systems."""
