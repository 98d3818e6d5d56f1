"""The Astyx HiRes2019 set."""

from fbench.datasets.astyx.importer import Astyx

__all__ = ["Astyx"]
