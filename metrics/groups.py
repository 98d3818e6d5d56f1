"""Classes as they are scored: all vehicles as one, or one label."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.items import Items
from fbench.replay.arrays import Bool
from fbench.replay.data import VEHICLES


@dataclass(frozen=True)
class Group:
    """Labels that are scored as one class; the label among them isn't compared."""

    name: str
    labels: tuple[str, ...]
    agnostic: bool
    """Whether boxes without a label belong to it."""

    def holds(self, items: Items) -> Bool:
        """Tell which items (N,) are of this class."""
        own: Bool = np.isin(items.label, self.labels)
        return own | (items.label == "") if self.agnostic else own

    def counts(self, truth: Items) -> Bool:
        """Tell which truth boxes (N,) must be found: of this class, in the region, not ignored."""
        return self.holds(truth) & truth.inside & ~truth.ignore

    def excused(self, truth: Items, estimates: Items) -> Bool:
        """Tell which truth boxes (N, 1 or M) that needn't be found excuse which estimates (M,).

        Truth of this class does always. An ignore region without a class, too. Truth of another class does so
        only for estimates that have no label: a labelled one has the wrong label.
        """
        region = truth.ignore & np.isin(truth.label, ["", "other"])
        same = self.holds(truth) | region
        excused: Bool = same[:, None] | (estimates.label == "")[None, :]
        return excused


VEHICLE = Group("vehicle", VEHICLES, agnostic=True)


def label_group(label: str) -> Group:
    """Return the group of one label alone."""
    return Group(label, (label,), agnostic=False)
