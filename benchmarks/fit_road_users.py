"""Fit the model that tells road users by LiDAR: writes `pipelines/sensors/lidar/road_users.json`, which fbench ships.

Drives of development seeds are simulated with LiDARs of 16 to 128 channels on the roof and on the hood or bumper. Each
cluster is described by `features`, and is a road user where it holds most of what the LiDAR sees of one. The model is
a multinomial logistic regression over piecewise linear functions of the features, which vary with how high the LiDAR
looks; the same inputs give the same file.
It takes some minutes: `python benchmarks/fit_road_users.py [OUT.json]`.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from sklearn.linear_model import LogisticRegression

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import LidarSpec, RigSpec
from fbench.datasets.city.spec import CitySpec, WorldName, condition
from fbench.pipelines.sensors.lidar.classification import FEATURES, FITTED, Seen, features, interpolation_weights
from fbench.pipelines.sensors.lidar.clusters import LidarParams, obstacles, sort_by_cluster
from fbench.pipelines.sensors.lidar.clusters import clusters as clustered
from fbench.pipelines.sensors.points.merged import Outline
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.transforms import transform

WORLDS: tuple[WorldName, ...] = ("urban", "highway")
DRIVES = (("clear", 101), ("clear", 104), ("traffic", 107), ("rain", 108))
"""Conditions and seeds; both worlds have them all."""
SECONDS, RATE_HZ = 7.0, 2.0
LIDARS = {
    "dense": LidarSpec(translation_m=(0.0, 0.0, 2.0), rate_hz=RATE_HZ, points_per_s=100_000),
    "l16": LidarSpec(translation_m=(0.0, 0.0, 1.9), rate_hz=RATE_HZ, channels=16, points_per_s=57_600,
                     upper_deg=15.0, lower_deg=-15.0, noise_m=0.02),
    "l32": LidarSpec(translation_m=(0.5, 0.0, 1.8), rate_hz=RATE_HZ, channels=32, points_per_s=69_120,
                     upper_deg=10.0, lower_deg=-30.0, noise_m=0.02),
    "l64": LidarSpec(translation_m=(0.0, 0.0, 1.75), rate_hz=RATE_HZ, channels=64, points_per_s=128_000,
                     upper_deg=2.0, lower_deg=-24.8, noise_m=0.02),
    "h16": LidarSpec(translation_m=(1.6, 0.0, 1.0), rate_hz=RATE_HZ, channels=16, points_per_s=57_600,
                     upper_deg=15.0, lower_deg=-15.0, noise_m=0.02),
    "h32": LidarSpec(translation_m=(1.6, 0.0, 1.0), rate_hz=RATE_HZ, channels=32, points_per_s=69_120,
                     upper_deg=10.0, lower_deg=-30.0, noise_m=0.02),
    "h64": LidarSpec(translation_m=(2.2, 0.0, 0.7), rate_hz=RATE_HZ, channels=64, points_per_s=128_000,
                     upper_deg=2.0, lower_deg=-24.8, noise_m=0.02),
    "h128": LidarSpec(translation_m=(1.9, 0.0, 0.8), rate_hz=RATE_HZ, channels=128, points_per_s=256_000,
                      upper_deg=15.0, lower_deg=-25.0, noise_m=0.02),
}  # fmt: skip
"""The thesis's, such as were mounted when Astyx, nuScenes and KITTI were recorded, and others mounted low."""
LABELS = {"car": ("car",), "van": ("van",), "truck": ("truck", "bus", "trailer"), "motorcycle": ("motorcycle",),
          "bicycle": ("bicycle",), "pedestrian": ("pedestrian",)}  # fmt: skip
"""Classes of the model and the labels that belong to them."""
KNOTS = {
    "length_m": (0.2, 0.5, 0.8, 1.2, 1.6, 2.0, 2.5, 3.5, 4.5, 5.5, 7.0, 10.0, 14.0),
    "width_m": (0.05, 0.2, 0.4, 0.6, 0.9, 1.3, 1.7, 2.1, 2.5, 3.0, 4.0),
    "top_m": (0.4, 0.7, 0.9, 1.1, 1.3, 1.5, 1.7, 1.9, 2.2, 2.6, 3.2, 4.0, 5.0),
    "reach_m": (0.6, 0.9, 1.1, 1.3, 1.5, 1.8, 2.2, 2.7, 3.5, 5.0),
    "bottom_m": (0.2, 0.4, 0.6, 0.8, 1.1, 1.5),
    "log2_points": (1.5, 2.5, 3.5, 4.5, 6.0, 8.0, 10.0),
    "filling_m": (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45),
    "upper_share": (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95),
    "over_share": (0.0, 0.02, 0.1, 0.25, 0.5, 0.8),
    "near_share": (0.0, 0.02, 0.1, 0.25, 0.5, 0.8),
}
"""Where the functions of the features bend."""
CEILINGS_M = (1.0, 2.0, 4.0)
"""Heights up to which the LiDAR looks at a cluster, between which the functions change."""
INVERSE_PENALTY = 0.3  # scikit-learn's C: large coefficients cost, so that few examples don't decide
WHOLE, PART = 0.4, 0.25
"""Intersection over union of a cluster's points with those in a box: from `WHOLE` on the best cluster of the box is
that road user; with less than that but more than `PART` it's left out, being neither.
"""
MARGIN_M = 0.15


def frames(world: WorldName, name: str, seed: int) -> Iterator[tuple[Rig, PointCloud, Boxes3D]]:
    """Yield the clouds of a drive with what is true at their stamps."""
    rig = RigSpec(lidars=LIDARS)
    recording = CityRecording(CitySpec(world, condition(name), SECONDS, seed, rig), "drive")
    clouds: dict[int, list[PointCloud]] = {}
    truths: dict[int, Boxes3D] = {}
    for item in recording.items():
        if isinstance(item, PointCloud):
            clouds.setdefault(item.stamp_ns, []).append(item)
        elif isinstance(item, Truth) and item.boxes3d is not None:
            truths[item.stamp_ns] = item.boxes3d
    for stamp_ns, boxes in sorted(truths.items()):
        for cloud in sorted(clouds.get(stamp_ns, []), key=lambda c: c.sensor):
            yield recording.rig, cloud, boxes


def clusters(rig: Rig, cloud: PointCloud, params: LidarParams) -> tuple[Float64, Int64, Seen | None]:
    """Return the obstacles (N, 3) of one cloud in body coordinates, their clusters (N,), and what these are like."""
    body_T_sensor = rig.body_T_sensor(cloud.sensor)
    points = transform(body_T_sensor, cloud.xyz[np.linalg.norm(cloud.xyz, axis=1) >= params.min_range_m])
    points = points[Outline(params.ego_front_m, params.ego_rear_m, params.ego_side_m).without(points)]
    found = obstacles(points[np.lexsort(points.T[::-1])], params)
    return sort_by_cluster(found, clustered(found.xyz, params.cluster), body_T_sensor[:3, 3])


def match_boxes(boxes: Boxes3D, xyz: Float64, cluster: Int64, num: int) -> tuple[Int64, Float64]:
    """Return for each of `num` clusters the box that shares most points with it, -1: none, and how well (IoU)."""
    best, value = np.full(num, -1), np.zeros(num)
    size = np.bincount(cluster[cluster >= 0], minlength=num)
    for row in range(len(boxes)):
        x, y, z = (xyz - boxes.center_m[row]).T  # members lie in the box, or hardly outside
        cos, sin = np.cos(boxes.yaw_rad[row]), np.sin(boxes.yaw_rad[row])
        own = np.column_stack([cos * x + sin * y, cos * y - sin * x, z])
        members = (np.abs(own) < boxes.size_lwh_m[row] / 2 + MARGIN_M).all(axis=1)
        common = np.bincount(cluster[members & (cluster >= 0)], minlength=num)
        iou = common / np.maximum(size + members.sum() - common, 1)
        best, value = np.where(iou > value, row, best), np.maximum(iou, value)
    return best, value


def targets(boxes: Boxes3D, best: Int64, iou: Float64) -> Int64:
    """Class (M,) of each cluster: 0 is no road user, -1 is left out."""
    assert boxes.label is not None
    result = np.zeros(len(best), np.int64)
    number = {label: k for k, labels in enumerate(LABELS.values(), 1) for label in labels}
    taken: set[int] = set()
    for m in np.argsort(-iou, kind="stable"):
        row = int(best[m])
        if row < 0 or row in taken or iou[m] <= PART:
            continue
        if iou[m] > WHOLE:
            taken.add(row)
            result[m] = number.get(str(boxes.label[row]), -1)
        else:
            result[m] = -1
    return result


def examples() -> tuple[Float64, Float64, Int64]:
    """Features (M, F), ceilings (M,) and classes (M,) of the clusters of all drives."""
    params, described, ceilings, classes = LidarParams(), [], [], []
    for world in WORLDS:
        for name, seed in DRIVES:
            for rig, cloud, boxes in frames(world, name, seed):
                xyz, cluster, seen = clusters(rig, cloud, params)
                if seen is None:
                    continue
                described.append(features(seen.standing, seen.rectangles))
                ceilings.append(seen.ceiling_m)
                classes.append(targets(boxes, *match_boxes(boxes, xyz, cluster, len(seen.rectangles))))
            print(f"{world} {name} {seed}: {sum(map(len, classes))} clusters so far", flush=True)
    x, ceiling, y = np.concatenate(described), np.concatenate(ceilings), np.concatenate(classes)
    return x[y >= 0], ceiling[y >= 0], y[y >= 0]


def fit_model(x: Float64, ceiling_m: Float64, y: Int64) -> dict[str, object]:
    """Fit the model to features (M, F), ceilings (M,) and classes (M,), and return what the file holds.

    Coefficients are a part that all ceilings share and what each from the second on differs by, so that the penalty
    keeps apart only what the examples do.
    """
    columns = [interpolation_weights(column, np.array(KNOTS[name])) for name, column in zip(FEATURES, x.T, strict=True)]
    shared, num = np.column_stack(columns), len(CEILINGS_M)
    contrast = np.eye(num)[:, 1:] - 1 / num  # (L, L - 1) how much of each difference acts at each ceiling
    parts = interpolation_weights(ceiling_m, np.array(CEILINGS_M)) @ contrast
    design = np.column_stack([shared, *(shared * part[:, None] for part in parts.T)])
    regression = LogisticRegression(C=INVERSE_PENALTY, max_iter=1000).fit(design, y)
    assert regression.classes_.tolist() == list(range(len(LABELS) + 1))
    weights: Array = (regression.coef_[1:] - regression.coef_[0]).reshape(len(LABELS), num, -1)
    at_ceiling = weights[:, 0] + np.einsum("lj,cjk->lck", contrast, weights[:, 1:])
    ends = np.cumsum([len(KNOTS[name]) for name in FEATURES])[:-1]
    by_feature = {
        name: {"knots": list(KNOTS[name]), "log_odds": np.round(part, 3).tolist()}
        for name, part in zip(FEATURES, np.split(at_ceiling, ends, axis=2), strict=True)
    }
    offset = np.round(regression.intercept_[1:] - regression.intercept_[0], 3).tolist()
    return {"labels": list(LABELS), "offset": offset, "ceiling_m": list(CEILINGS_M), "features": by_feature}


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else FITTED
    x, ceiling_m, y = examples()
    counts = np.bincount(y, minlength=len(LABELS) + 1).tolist()
    print(", ".join(f"{name} {count}" for name, count in zip(("other", *LABELS), counts, strict=True)))
    out.write_text(json.dumps(fit_model(x, ceiling_m, y), indent=1) + "\n")


if __name__ == "__main__":
    main()
