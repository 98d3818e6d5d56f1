"""Which boxes the nuScenes benchmarks count, as data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BoxRules:
    """Filters of both benchmarks; nuscenes-devkit 1.2.0, eval/common/loaders.py, `filter_eval_boxes`."""

    class_range_m: tuple[tuple[str, float], ...]
    """Classes with the distance from the ego, in the ground plane, from which on their boxes don't count."""
    max_boxes: int = 500
    """Results with more boxes than this in one sample are refused."""
    rack_label: str = "static_object.bicycle_rack"
    rack_classes: tuple[str, ...] = ("bicycle", "motorcycle")
    """Their boxes don't count where the centre is in a bicycle rack of the truth."""

    @property
    def classes(self) -> tuple[str, ...]:
        """Names, in the order of the benchmark's configuration."""
        return tuple(name for name, _ in self.class_range_m)


_VEHICLES_M, _PEOPLE_M, _STATIC_M = 50.0, 40.0, 30.0

DETECTION_RULES = BoxRules(
    (
        ("car", _VEHICLES_M),
        ("truck", _VEHICLES_M),
        ("bus", _VEHICLES_M),
        ("trailer", _VEHICLES_M),
        ("construction_vehicle", _VEHICLES_M),
        ("pedestrian", _PEOPLE_M),
        ("motorcycle", _PEOPLE_M),
        ("bicycle", _PEOPLE_M),
        ("traffic_cone", _STATIC_M),
        ("barrier", _STATIC_M),
    )
)
"""`detection_cvpr_2019.json`"""

TRACKING_RULES = BoxRules(
    (
        ("bicycle", _PEOPLE_M),
        ("bus", _VEHICLES_M),
        ("car", _VEHICLES_M),
        ("motorcycle", _PEOPLE_M),
        ("pedestrian", _PEOPLE_M),
        ("trailer", _VEHICLES_M),
        ("truck", _VEHICLES_M),
    )
)
"""`tracking_nips_2019.json`"""
