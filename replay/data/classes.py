"""Classes of road users as other systems name them, mapped to those of fbench."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from fbench.replay.data.arrays import text_array
from fbench.replay.data.boxes import LABELS, Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth

B = TypeVar("B", Boxes2D, Boxes3D)

IGNORE = "ignore"  # Instead of a label: boxes of the class count neither as hits nor as misses

_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "car": ("sedan", "suv", "taxi", "passenger_car", "vehicle_car", "32001"),
    "van": ("minivan",),
    "truck": ("lorry", "pickup_truck", "vehicle_truck", "32002"),
    "bus": ("coach", "vehicle_bus", "32003"),
    "trailer": ("semitrailer", "semi_trailer", "32004"),
    "motorcycle": ("motorbike", "motorcyclist", "moped", "scooter", "32005"),
    "bicycle": ("bike", "cyclist", "bicyclist", "32006"),
    "pedestrian": ("person", "people", "human", "walker", "person_sitting", "32007"),
    "other": (),
}
"""Numbers are those of Autoware for `radar_msgs/RadarTrack.classification`."""
_LABELS = {name: label for label in LABELS for name in (label, *_SYNONYMS[label])}


def labels(names: Sequence[str]) -> dict[str, Any]:
    """Columns `label` and `source_label` of boxes; what isn't known is `other`."""
    return {"label": text_array([label(name) for name in names]), "source_label": text_array(list(names))}


def label(name: str) -> str:
    """The class of fbench for the name of another system, whatever its case, spaces and dashes; else `other`. Without a
    name there is no class: such boxes are scored as those of sensors that know none.
    """
    return _LABELS.get(_plain(name), "other") if name.strip() else ""


def is_known(name: str) -> bool:
    """Tell whether the name of a class says what it is without a map."""
    return _plain(name) in _LABELS


@dataclass(frozen=True)
class ClassMap:
    """Labels by the names that a source gives to classes; boxes of other names keep theirs."""

    own: Mapping[str, str] = field(default_factory=dict)
    """A label of fbench or `ignore`, by name, exactly as the source writes it."""

    def apply(self, boxes: B, unknown: Callable[[str], None]) -> B:
        """Label boxes by their `source_label`, where they have one, telling `unknown` each name that means nothing."""
        if boxes.source_label is None:
            return boxes
        names = boxes.source_label.tolist()
        counted = names if boxes.ignore is None else boxes.source_label[~boxes.ignore].tolist()
        for name in dict.fromkeys(counted):
            if name and name not in self.own and not is_known(name):
                unknown(name)
        if self.own.keys().isdisjoint(names):
            return boxes
        before = [label(name) for name in names] if boxes.label is None else boxes.label.tolist()
        found = [self.own.get(name, old) for name, old in zip(names, before, strict=True)]
        ignored = np.array([text == IGNORE for text in found], bool)
        columns: dict[str, Any] = {"label": text_array(["other" if text == IGNORE else text for text in found])}
        if ignored.any():
            columns["ignore"] = ignored if boxes.ignore is None else boxes.ignore | ignored
        return replace(boxes, **columns)

    def label_truth(self, truth: Truth, unknown: Callable[[str], None]) -> Truth:
        """Label all boxes of a truth; see `apply`."""
        boxes3d = None if truth.boxes3d is None else self.apply(truth.boxes3d, unknown)
        boxes2d = None if truth.boxes2d is None else self.apply(truth.boxes2d, unknown)
        return replace(truth, boxes3d=boxes3d, boxes2d=boxes2d)


def _plain(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_").replace(".", "_")
