"""RADIATE."""

from fbench.datasets.radiate.importer import Radiate
from fbench.datasets.radiate.params import RadiateParams

__all__ = ["Radiate", "RadiateParams"]
