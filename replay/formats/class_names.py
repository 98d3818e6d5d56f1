"""Classes as the benchmarks call them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.data.arrays import Text
from fbench.replay.formats.export_request import ExportWish, Format

Namer = Callable[[Text, Text], list[str]]


@dataclass(frozen=True)
class ClassTable:
    """One benchmark's classes."""

    own: Mapping[str, str]
    """Names by what datasets call a class (`source_label`), where the benchmark tells more classes apart than fbench;
    empty: has no place in it."""
    labels: Mapping[str, str]
    """Names by the labels of fbench; without one: has no place."""

    @property
    def names(self) -> tuple[str, ...]:
        """All classes."""
        return tuple(sorted({*self.own.values(), *self.labels.values()} - {""}))

    def name(self, source_label: str, label: str) -> str | None:
        """Name of a class; empty: has no place, `None`: the box has no class."""
        if source_label in self.own:
            return self.own[source_label]
        return self.labels.get(label, "") if label else None


_KITTI = ClassTable(
    {
        name: name
        for name in ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Person", "Cyclist", "Tram", "Misc")
    },
    {
        "car": "Car", "van": "Van", "truck": "Truck", "pedestrian": "Pedestrian", "bicycle": "Cyclist", "bus": "Misc",
        "trailer": "Misc", "motorcycle": "Misc", "other": "Misc",
    },
)  # fmt: skip
MOT_NUMBERS = {
    "pedestrian": 1, "person on vehicle": 2, "car": 3, "bicycle": 4, "motorbike": 5, "non motorized vehicle": 6,
    "static person": 7, "distractor": 8, "occluder": 9, "occluder on the ground": 10, "occluder full": 11,
    "reflection": 12, "crowd": 13,
}  # fmt: skip
"""Of MOT16 and later (A. Milan et al., "MOT16: A Benchmark for Multi-Object Tracking", table 3)."""
_MOT = ClassTable(
    {name: name for name in MOT_NUMBERS},
    {
        "car": "car", "van": "car", "truck": "car", "bus": "car", "trailer": "car", "motorcycle": "motorbike",
        "bicycle": "bicycle", "pedestrian": "pedestrian", "other": "distractor",
    },
)  # fmt: skip
_NUSCENES_LABELS = {
    "car": "car", "van": "car", "truck": "truck", "bus": "bus", "trailer": "trailer", "motorcycle": "motorcycle",
    "bicycle": "bicycle", "pedestrian": "pedestrian",
}  # fmt: skip
_PEOPLE = ("adult", "child", "construction_worker", "police_officer")
_NUSCENES_OWN = {
    **{f"human.pedestrian.{kind}": "pedestrian" for kind in _PEOPLE},
    **{f"human.pedestrian.{kind}": "" for kind in ("personal_mobility", "stroller", "wheelchair")},
    **dict.fromkeys(("vehicle.emergency.ambulance", "vehicle.emergency.police"), ""),
    "vehicle.bus.bendy": "bus", "vehicle.bus.rigid": "bus", "vehicle.construction": "construction_vehicle",
    "movable_object.barrier": "barrier", "movable_object.trafficcone": "traffic_cone", "barrier": "barrier",
    "traffic_cone": "traffic_cone", "construction_vehicle": "construction_vehicle",
}  # fmt: skip
"""`eval/detection/README.md` of the devkit, section Classes; other names follow from labels."""
_UNTRACKED = ("barrier", "traffic_cone", "construction_vehicle")
TABLES: Mapping[Format, ClassTable] = {
    "kitti": _KITTI,
    "kitti-tracking": _KITTI,
    "mot": _MOT,
    "nuscenes": ClassTable(_NUSCENES_OWN, _NUSCENES_LABELS),
    "nuscenes-tracking": ClassTable(
        {name: "" if known in _UNTRACKED else known for name, known in _NUSCENES_OWN.items()}, _NUSCENES_LABELS
    ),
}


def require_class(wish: ExportWish) -> None:
    """Refuse a class that the format doesn't have.

    Raises:
        ConfigError: naming the nearest one.
    """
    names = TABLES[wish.format].names
    if wish.class_name and wish.class_name not in names:
        raise ConfigError(f"--class {wish.class_name}: no class of {wish.format}{did_you_mean(wish.class_name, names)}")


def namer(wish: ExportWish, where: str) -> Namer:
    """Return what tells the class of each box as the format calls it, from `source_label` and `label`; empty: has no
    place in it.
    """
    table = TABLES[wish.format]
    known: dict[tuple[str, str], str] = {}

    def name(source_label: str, label: str) -> str:
        found = table.name(source_label, label)
        if found is None and not wish.class_name:
            example = next(iter(table.labels.values()))
            raise LogError(f"{where}: boxes without a class; say which they are of with --class, such as {example}")
        return wish.class_name if found is None else found

    def names(source_labels: Text, labels: Text) -> list[str]:
        pairs = list(zip(source_labels.tolist(), labels.tolist(), strict=True))
        for pair in dict.fromkeys(pairs):
            if pair not in known:
                known[pair] = name(*pair)
        return [known[pair] for pair in pairs]

    return names
