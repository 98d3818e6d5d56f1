"""RADIATE."""

from fbench.datasets.radiate.importer import Radiate
from fbench.datasets.radiate.radar import RadiateParams

__all__ = ["Radiate", "RadiateParams"]
