"""What the shape of a group's points says."""

import numpy as np

from fbench.pipelines.early.boxes import Shapes
from fbench.pipelines.early.groups import Groups
from fbench.pipelines.early.scene import Scene
from fbench.pipelines.points.features import Standing
from fbench.pipelines.points.judging import Seen, like_cars, road_users
from fbench.replay.arrays import Float64, Int64, Text
from fbench.replay.data import Source

LONG_M = 7.0
"""Objects longer than this [m] whose class neither cameras nor shapes tell are called trucks, others cars."""


def judged(scene: Scene, groups: Groups, shape: Shapes) -> tuple[Float64, Text]:
    """Probability (M,) that groups are road users by the shape of their LiDAR and stereo points, NaN where they are too
    few, and labels (M,) by shape.
    """
    probability, label = np.full(len(groups), np.nan), np.full(len(groups), "car", "<U16")
    rows = np.flatnonzero(shape.by_shape)
    if scene.plane is None or not len(rows):
        return probability, label
    seen = Seen(_standing(scene, groups, rows), shape.rectangles[rows], scene.plane, scene.eye_m)
    how = scene.lidar
    boxes = road_users(seen, how.size, how.sizes) if how.judge == "model" else like_cars(seen, how.size, how.shape)
    if boxes.score is not None:
        probability[rows] = boxes.score
    long = np.hypot(*(shape.rectangles[:, [2, 4]] - shape.rectangles[:, [1, 3]]).T) > LONG_M
    label[long] = "truck"
    if boxes.label is not None:
        label[rows] = boxes.label
    return probability, label


def _standing(scene: Scene, groups: Groups, chosen: Int64) -> Standing:
    """Points of LiDAR and stereo as they are judged: sorted by chosen group, those of no such group first."""
    cloud, number = scene.cloud, np.full(len(scene.cloud), -1)
    place = np.full(len(groups), -1)
    place[chosen] = np.arange(len(chosen))
    number[groups.rows] = place[groups.number]
    rows = np.flatnonzero(cloud.source != int(Source.R))
    rows = rows[np.argsort(number[rows], kind="stable")]
    first = np.searchsorted(number[rows], np.arange(len(chosen) + 1))
    tall = scene.tall.copy()
    if scene.plane is not None:
        tall[:, 2] -= scene.plane.z_m(tall)
    return Standing(np.column_stack([cloud.xyz[rows, :2], cloud.height_m[rows]]), first, tall)
