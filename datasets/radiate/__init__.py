"""RADIATE."""

from fbench.datasets.radiate.importer import Radiate

__all__ = ["Radiate"]
