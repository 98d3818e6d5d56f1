"""Importer of Argoverse 2's sensor dataset."""

from fbench.datasets.av2.importer import Av2

__all__ = ["Av2"]
