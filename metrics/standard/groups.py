"""Classes as they are scored: all vehicles as one, or one label."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.objects import Objects
from fbench.replay.arrays import Bool, Int64
from fbench.replay.data import VEHICLES


@dataclass(frozen=True)
class Group:
    """Labels that are scored as one class; the label among them isn't compared."""

    name: str
    labels: tuple[str, ...]
    agnostic: bool
    """Whether boxes without a label belong to it."""

    def holds(self, objects: Objects) -> Bool:
        """Tell which objects (N,) are of this class."""
        own: Bool = np.isin(objects.label, self.labels)
        return own | (objects.label == "") if self.agnostic else own

    def counts(self, truth: Objects) -> Bool:
        """Tell which truth boxes (N,) must be found: of this class, in the region, not ignored."""
        held = self.holds(truth)
        held = held if truth.inside is None else held & truth.inside
        return held if truth.ignore is None else held & ~truth.ignore

    def excuses(self, truth: Objects, estimates: Objects, pairs: tuple[Int64, Int64]) -> Bool:
        """Tell in which pairs (B,) of rows the truth box, which needn't be found, excuses the estimate.

        Truth of this class does always. An ignore region without a class, too. Truth of another class does so
        only for estimates that have no label: a labelled one has the wrong label.
        """
        always = self.holds(truth)
        if truth.ignore is not None:
            always |= truth.ignore & np.isin(truth.label, ["", "other"])
        excused: Bool = always[pairs[0]] | (estimates.label == "")[pairs[1]]
        return excused


VEHICLE = Group("vehicle", VEHICLES, agnostic=True)


def label_group(label: str) -> Group:
    """Return the group of one label alone."""
    return Group(label, (label,), agnostic=False)
