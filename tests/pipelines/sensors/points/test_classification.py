"""What becomes of clusters, by the model and by rules."""

import numpy as np
import pytest
from tests.pipelines.frames import cloud, fields, frame, rig
from tests.pipelines.scenes import road

from fbench.pipelines.sensors.lidar.classification import Seen, Standing, add_rules
from fbench.pipelines.sensors.lidar.clusters import LidarParams, LidarView, detect, obstacles, resolve_judge
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.variants.lidar import Lidar3D, Lidar3DParams
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo

SIMULATION = LogInfo("drive", "id", {SIMULATED: "city"})


def box(x_m, y_m, size_lwh, z_m=-1.6, step_m=0.15):
    """Points on the two sides and the back of an upright box whose back is at `x_m`, seen from the right behind."""
    length, width, height = size_lwh
    z = np.arange(0.3, height, step_m) + z_m
    back = [(x_m, y_m + y, h) for y in np.arange(-width / 2, width / 2 + 1e-9, step_m) for h in z]
    side = [(x_m + x, y_m - width / 2 * np.sign(y_m), h) for x in np.arange(0, length + 1e-9, step_m) for h in z]
    return np.array(back + side)


def view(*parts, judge="model") -> LidarView:
    points = np.concatenate([road(), *parts])
    params = LidarParams(judge=judge)
    return detect(obstacles(points[np.lexsort(points.T[::-1])], params), np.zeros(3), params)


@pytest.mark.parametrize(
    ("size", "labels"),
    [((4.3, 1.8, 1.5), {"car"}), ((8.0, 2.5, 3.4), {"truck"}), ((0.5, 0.5, 1.75), {"pedestrian"})],
)
def test_the_model_tells_classes_apart(size, labels):
    found = view(box(14.0, 4.0, size)).boxes
    best = int(np.argmax(found.score))
    assert found.score[best] > 0.5
    assert found.label[best] in labels
    assert found.center_m[best, :2] == pytest.approx([14.0 + size[0] / 2, 4.0], abs=0.4)
    assert found.size_lwh_m[best, :2] == pytest.approx(size[:2], abs=0.5)


def test_a_part_of_a_vehicle_is_no_second_one():
    """A bumper apart from the rest: what is likelier stays, the other is hardly believed."""
    car, bumper = box(14.0, 4.0, (4.3, 1.8, 1.5)), box(13.2, 4.0, (0.1, 1.7, 0.9))
    both, alone = view(car, bumper).boxes, view(bumper).boxes
    assert len(both) == 2
    assert both.score.max() > 0.5
    assert both.score.min() < 0.5 * alone.score[0]


def test_rules_give_no_labels():
    found = view(box(14.0, 4.0, (4.3, 1.8, 1.5)), judge="rules").boxes
    assert found.label is None
    assert found.score.tolist() == [1.0]


def test_the_model_alone_judges_simulated_logs_and_those_that_ask_for_it():
    assert resolve_judge(LidarParams(), SIMULATION).judge == "model"
    assert resolve_judge(LidarParams(), LogInfo("drive", "id")).judge == "both"
    assert resolve_judge(LidarParams(judge="rules"), SIMULATION).judge == "rules"
    assert resolve_judge(LidarParams(judge="model"), LogInfo("drive", "id")).judge == "model"


def test_model_and_rules_together_take_the_mean_of_their_log_odds():
    probability = np.array([[0.8, 0.1, 0.05], [0.6, 0.2, 0.0], [0.0, 0.0, 0.9]])
    is_vehicle = np.array([True, True, False])
    pooled = add_rules(probability, is_vehicle, np.array([0.0, 1.0, 0.0]))
    # 0.9 and, limited to 0.1: even odds; 0.8 and, limited to 0.9: odds 4 and 9, of which the mean is 6.
    assert pooled[0].tolist() == pytest.approx([0.5 * 8 / 9, 0.5 / 9, 0.05])
    assert pooled[1].tolist() == pytest.approx([6 / 7 * 0.75, 6 / 7 * 0.25, 0.0])
    assert pooled[2].tolist() == pytest.approx([0.0, 0.0, 0.9], abs=1e-4)  # not a vehicle: rules say nothing


@pytest.mark.parametrize(("step_deg", "density"), [(1.0, 49 / 36), (0.5, 169 / 36), (0.25, 625 / 36), (2.0, 0.0)])
@pytest.mark.parametrize("ahead_rad", [0.0, np.pi])
def test_density_is_points_by_the_angles_that_clusters_fill(step_deg, density, ahead_rad):
    """Walls of 6 by 6 degrees; 16 points are too few to tell."""
    angles = np.radians(np.arange(-3, 3.01, step_deg))
    aside, up = (a.ravel() for a in np.meshgrid(angles, angles))
    points = 20.0 * np.column_stack([np.cos(aside + ahead_rad), np.sin(aside + ahead_rad), np.tan(up)])
    points[:, 2] += 1.6  # over the ground, as high as the LiDAR is
    standing = Standing(np.concatenate([points, points]), np.array([0, len(points), 2 * len(points)]), np.zeros((0, 3)))
    seen = Seen(standing, np.zeros((2, 6)), Plane(0.0, 0.0, -1.6), np.zeros(3))
    assert seen.density_per_deg2 == pytest.approx(density)


def test_the_denser_a_lidar_the_less_rules_count():
    probability, score = np.array([[0.8, 0.0, 0.1]]), np.array([0.0])
    found = [add_rules(probability, np.array([True, True, False]), score, share)[0, 0] for share in (0.5, 0.25, 0.0)]
    assert found[0] < found[1] < found[2] == pytest.approx(0.8)


def test_a_car_that_a_dense_lidar_sees_from_above_isnt_rejected_by_rules():
    x, y = np.meshgrid(np.arange(12.0, 16.3, 0.1), np.arange(2.0, 3.8, 0.1))
    roof = np.column_stack([x.ravel(), y.ravel(), -0.15 - 0.35 * (np.abs(x.ravel() - 14.2) > 1.2)])
    top = np.concatenate([box(14.15, 2.9, (4.3, 1.8, 1.1)), roof])
    scores = {judge: view(top, judge=judge).boxes.score.max() for judge in ("rules", "model", "both")}
    assert scores["rules"] < 0.1
    assert scores["both"] == pytest.approx(scores["model"], rel=1e-12), "at this density, rules don't count"
    assert scores["both"] > 0.4


def test_frames_without_boxes_have_the_same_fields_when_the_model_judges():
    pipeline = Lidar3D(Lidar3DParams(min_score=0.1))
    pipeline.start(rig("lidar"), SIMULATION)
    full = pipeline.step(frame(0, cloud()))
    assert len(full.detections) > 0
    missing = pipeline.step(frame(1))
    empty = pipeline.step(frame(2, PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))))
    for output in (missing, empty):
        assert fields(output.detections) == fields(full.detections)
        assert fields(output.tracks) == fields(full.tracks)


def seen_by(xy_height, viewpoint_m):
    """Points, each a cluster of its own, above the ground at z = -1.4."""
    x, y = xy_height[:, 0], xy_height[:, 1]
    rectangles = np.column_stack([0 * x, x - 0.1, y - 0.5, x + 0.1, y + 0.5, 0 * x])
    standing = Standing(xy_height, np.arange(len(x) + 1), np.zeros((0, 3)))
    return Seen(standing, rectangles, Plane(0.0, 0.0, -1.4), np.array(viewpoint_m))


def test_how_high_a_lidar_looks_at_what_it_sees():
    """From 0.6 m above the ground it sees walls 10 m away up to 1.1 m all around: 0.05 m up for each meter. At 20 m
    that is 1.6 m.
    """
    angle = np.radians(np.arange(0.0, 360.0, 2.0))
    wall = np.column_stack([2.0 + 10.0 * np.cos(angle), 1.0 + 10.0 * np.sin(angle), np.full(len(angle), 1.1)])
    ceiling_m = seen_by(np.vstack([wall, [22.0, 1.0, 0.4]]), (2.0, 1.0, -0.8)).ceiling_m
    np.testing.assert_allclose(ceiling_m, [*[1.1] * len(wall), 1.6])


@pytest.mark.parametrize("height_m", [1.5, 0.5], ids=["above the LiDAR", "below it"])
def test_one_thing_alone_does_not_show_how_high_a_lidar_looks(height_m):
    up_m = 10.0 * np.tan(np.radians(15.0))
    assert seen_by(np.array([[12.0, 1.0, height_m]]), (2.0, 1.0, -0.8)).ceiling_m == pytest.approx(0.6 + up_m)
