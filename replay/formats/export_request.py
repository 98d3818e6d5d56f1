"""The request of an export, and classes as its formats call them."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.data.arrays import Text

Format = Literal["kitti", "kitti-tracking", "mot", "nuscenes", "nuscenes-tracking"]
Which = Literal["tracks", "detections", "truth"]
FORMATS: tuple[Format, ...] = get_args(Format)
_TRACKING: tuple[Format, ...] = ("kitti-tracking", "mot", "nuscenes-tracking")
_WHICH: tuple[Which, ...] = get_args(Which)
LeftOut = Counter[str]  # Boxes that the format has no place for, by the reason
Namer = Callable[[Text, Text], list[str]]


@dataclass(frozen=True)
class ExportRequest:
    """What is asked for."""

    format: Format
    boxes: Which | None = None  # `None`: of a run its tracks or detections, as the format goes; of a log its truth
    camera: str = ""  # Whose image 2D boxes are in; empty: that of KITTI's labels in a log of KITTI, else the only one
    frame: str = ""  # `body` or a camera that KITTI's 3D boxes are written in; empty: as the log says, else `camera`
    class_name: str = ""  # Class of boxes that have none, as the format calls it

    @property
    def is_tracking(self) -> bool:
        """Whether boxes need ids."""
        return self.format in _TRACKING

    @property
    def is_nuscenes(self) -> bool:
        """Whether the result is one file of boxes in the world."""
        return self.format.startswith("nuscenes")


def make_export_request(form: str, boxes: str | None, camera: str, frame: str, class_name: str) -> ExportRequest:
    """Read `--format`, `--boxes`, `--camera`, `--frame`, `--class`. ConfigError where one isn't known."""
    chosen = next((known for known in FORMATS if known == form), None)
    if chosen is None:
        raise ConfigError(f"--format {form}: isn't known{did_you_mean(form, FORMATS)}")
    which = next((known for known in _WHICH if known == boxes), None)
    if which is None and boxes is not None:
        raise ConfigError(f"--boxes {boxes}: isn't known{did_you_mean(boxes, _WHICH)}")
    return ExportRequest(chosen, which, camera, frame, class_name)


@dataclass(frozen=True)
class ClassTable:
    """One benchmark's classes."""

    own: Mapping[str, str]
    """Names by `source_label`, where the benchmark tells more classes apart than fbench; empty: has no place in it."""
    labels: Mapping[str, str]  # Names by the labels of fbench; without one: has no place

    def name(self, source_label: str, label: str) -> str | None:
        """Name of a class; empty: has no place, `None`: the box has no class."""
        if source_label in self.own:
            return self.own[source_label]
        return self.labels.get(label, "") if label else None


_KITTI_NAMES = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Person", "Cyclist", "Tram", "Misc")
_KITTI = ClassTable(
    {name: name for name in _KITTI_NAMES},
    {
        "car": "Car", "van": "Van", "truck": "Truck", "pedestrian": "Pedestrian", "bicycle": "Cyclist", "bus": "Misc",
        "trailer": "Misc", "motorcycle": "Misc", "other": "Misc",
    },
)  # fmt: skip
MOT_CLASSES = {
    1: ("pedestrian", "pedestrian"), 2: ("person on vehicle", "pedestrian"), 3: ("car", "car"),
    4: ("bicycle", "bicycle"), 5: ("motorbike", "motorcycle"), 6: ("non motorized vehicle", "other"),
    7: ("static person", "pedestrian"), 8: ("distractor", "other"), 9: ("occluder", "other"),
    10: ("occluder on the ground", "other"), 11: ("occluder full", "other"), 12: ("reflection", "other"),
    13: ("crowd", "other"),
}  # fmt: skip
"""Name, label by number, from MOT16 on (A. Milan et al., "MOT16: A Benchmark for Multi-Object Tracking", table 3)."""
_MOT = ClassTable(
    {name: name for name, _ in MOT_CLASSES.values()},
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
_TRACKED_OWN = {name: "" if known in _UNTRACKED else known for name, known in _NUSCENES_OWN.items()}
AV2_CLASSES: Mapping[str, str] = {
    "REGULAR_VEHICLE": "car", "LARGE_VEHICLE": "truck", "BUS": "bus", "BOX_TRUCK": "truck", "TRUCK": "truck",
    "VEHICULAR_TRAILER": "trailer", "TRUCK_CAB": "truck", "SCHOOL_BUS": "bus", "ARTICULATED_BUS": "bus",
    "PEDESTRIAN": "pedestrian", "WHEELED_RIDER": "pedestrian", "BICYCLE": "bicycle", "BICYCLIST": "pedestrian",
    "MOTORCYCLE": "motorcycle", "MOTORCYCLIST": "pedestrian", "WHEELED_DEVICE": "other", "WHEELCHAIR": "other",
    "STROLLER": "other", "DOG": "other", "BOLLARD": "other", "CONSTRUCTION_CONE": "other", "SIGN": "other",
    "CONSTRUCTION_BARREL": "other", "STOP_SIGN": "other", "MOBILE_PEDESTRIAN_CROSSING_SIGN": "other",
    "MESSAGE_BOARD_TRAILER": "other",
}  # fmt: skip
"""Classes of Argoverse 2's challenges (av2-api 0.3.6, `evaluation/__init__.py`) and the labels nearest to them. A rider
and what is ridden have boxes of their own.
"""
_AV2 = ClassTable(
    {name: name for name in AV2_CLASSES},
    {
        "car": "REGULAR_VEHICLE", "van": "REGULAR_VEHICLE", "truck": "TRUCK", "bus": "BUS",
        "trailer": "VEHICULAR_TRAILER", "motorcycle": "MOTORCYCLE", "bicycle": "BICYCLE", "pedestrian": "PEDESTRIAN",
    },
)  # fmt: skip
TABLES: Mapping[Format | Literal["av2"], ClassTable] = {
    "av2": _AV2,
    "kitti": _KITTI,
    "kitti-tracking": _KITTI,
    "mot": _MOT,
    "nuscenes": ClassTable(_NUSCENES_OWN, _NUSCENES_LABELS),
    "nuscenes-tracking": ClassTable(_TRACKED_OWN, _NUSCENES_LABELS),
}


def namer(request: ExportRequest, where: str) -> Namer:
    """Return what names classes of boxes in the format, from `source_label` and `label`; empty: has no place in it."""
    table = TABLES[request.format]
    known: dict[tuple[str, str], str] = {}

    def names(source_labels: Text, labels: Text) -> list[str]:
        pairs = list(zip(source_labels.tolist(), labels.tolist(), strict=True))
        for pair in dict.fromkeys(pairs):
            if pair not in known:
                name = table.name(*pair)
                if name is None and not request.class_name:
                    example = f"--class, such as {next(iter(table.labels.values()))}"
                    raise LogError(f"{where}: boxes without a class; say which they are of with {example}")
                known[pair] = request.class_name if name is None else name
        return [known[pair] for pair in pairs]

    return names
