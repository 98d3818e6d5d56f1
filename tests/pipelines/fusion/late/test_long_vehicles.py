"""Trucks and buses, which sensors see in parts."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import RIG, car, lidar_view, outline, radar_view, seen

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import fuse
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.radar.stage import RadarView
from fbench.replay.data.boxes import concatenate
from fbench.replay.geometry.camera import project_boxes

PARAMS = FusionParams(lidar_weight=1.0)
BUS = (12.0, 2.6, 3.0)


def named(view: LidarView, *labels: str) -> LidarView:
    return replace(view, boxes=replace(view.boxes, label=np.array(labels)))


def as_car(view: RadarView) -> RadarView:
    """The same echoes, which radar takes for a car's."""
    short = car(view.xyz[0, 0] + 2.1)
    return replace(view, boxes=replace(view.boxes, center_m=short.center_m, size_lwh_m=short.size_lwh_m))


def middle_x_m(lidar_label: str, truth) -> float:
    views = seen(outline(truth, label="bus"), named(lidar_view(truth), lidar_label), as_car(radar_view(truth)))
    objects = fuse(views, PARAMS)
    assert objects.sources.tolist() == [7]
    return float(objects.center_m[0, 0])


def test_radar_does_not_pull_a_bus_nearer_that_lidar_takes_for_a_truck():
    truth = car(36.0, size=BUS)
    assert middle_x_m("truck", truth) == pytest.approx(36.0, abs=1.0)
    assert middle_x_m("car", truth) < 35.5  # What LiDAR takes for a car may be one: radar's length counts


def side_view(length_m: float, near_m: float = 20.0) -> CameraDetections:
    """What a detector sees of a bus that crosses ahead."""
    whole = car(near_m + 1.3, size=(length_m, 2.6, 3.0), yaw=np.pi / 2)
    return CameraDetections(project_boxes(RIG, "cam", whole)[0], np.array([0.8]), np.array(["bus"]))


@pytest.mark.parametrize(("length_m", "expected_m"), [(9.0, 12.0), (12.0, 12.0), (17.0, 17.0), (24.0, 18.75)])
def test_what_looks_longer_than_its_class_is_as_long_as_it_looks(length_m, expected_m):
    """As far as the law lets vehicles be."""
    found = fuse(seen(side_view(length_m)), PARAMS)
    assert found.size_lwh_m[0, 0] == pytest.approx(expected_m, abs=1.0)


def test_a_pedestrian_in_front_of_a_bus_does_not_take_its_place():
    bus = car(21.3, size=(12.0, 2.6, 3.0), yaw=np.pi / 2)
    person = car(19.0, size=(0.6, 0.6, 1.7))
    y = np.linspace(-5.0, 5.0, 60)
    side = np.column_stack([np.full(60, 20.0), y, np.tile([-0.5, 0.0, 0.5], 20)])
    front = np.column_stack([np.full(6, 18.8), np.linspace(-0.2, 0.2, 6), np.linspace(-1.0, 0.0, 6)])
    boxes = concatenate([bus, person])
    view = LidarView(
        lidar_view().plane,
        np.concatenate([side, front]),
        np.repeat([0, 1], [60, 6]),
        replace(boxes, score=np.array([0.05, 0.8]), label=np.array(["truck", "pedestrian"])),
    )
    found = fuse(seen(side_view(12.0), view), PARAMS)
    both = dict(zip(found.label.tolist(), found.sources.tolist(), strict=True))
    assert both["bus"] == 3  # Camera and LiDAR
    at = found.label.tolist().index("bus")
    assert found.center_m[at, :2] == pytest.approx([21.3, 0.0], abs=1.0)
