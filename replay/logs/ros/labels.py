"""Classes of road users as other systems name them, by those of fbench."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.arrays import Text
from fbench.replay.data import LABELS

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
    return {"label": _texts([label(name) for name in names]), "source_label": _texts(list(names))}


def label(name: str) -> str:
    """The class of fbench for the name of another system, whatever its case, spaces and dashes."""
    plain = name.strip().lower().replace(" ", "_").replace("-", "_").replace(".", "_")
    return _LABELS.get(plain, "other")


def _texts(names: list[str]) -> Text:
    return np.array(names, dtype=np.str_)
