"""Outlines of the objects of one cloud in images, on a flat road 1.6 m below a camera with a focal length of 500 px."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.frames import AHEAD
from tests.pipelines.fusion.early.clouds import L, R, S, joined, points
from tests.pipelines.scenes import car_back, echoes

from fbench.pipelines.fusion.early.cloud import Scene
from fbench.pipelines.fusion.early.fuse import EarlyParams, choose, find_candidates
from fbench.pipelines.fusion.early.groups import Groups
from fbench.pipelines.fusion.early.image import EarlyImageFusion, EarlyImageParams, fuse_in_images, range_rates
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.stage import Rays
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.boxes import Boxes2D, Source
from fbench.replay.data.rig import CameraModel, Mount, Rig

CAMERA = CameraModel(np.array([[500.0, 0, 399.5], [0, 500, 299.5], [0, 0, 1]]), (800, 600))
RIG = Rig(
    {"cam": Mount("camera", np.zeros(3), AHEAD), "left": Mount("camera", np.array([0.0, 1.0, 0.0]), AHEAD)},
    {"cam": CAMERA, "left": CAMERA},
)
BOX = [377.0, 299.5, 422.0, 339.5]
"""The back of a car 20 m ahead: 1.8 m are 45 px there, and 1.6 m are 40."""
AS_SEEN = EarlyImageParams(measured_share=0.0, weak_measured_share=0.0)
LEAST = 0.6
NOTHING = points(L, [])


def seen(*boxes: list[float], score: float = 0.9, label: str = "car") -> CameraDetections:
    num = len(boxes)
    return CameraDetections(np.reshape(boxes, (num, 4)), np.full(num, score), np.array([label] * num, "U9"), LEAST)


def found(cloud, cameras=None, params=AS_SEEN, rays=None, images=("cam",)) -> Boxes2D:
    scene = scene_of(cloud, cameras)
    return fuse_in_images(scene, images, {} if rays is None else {"cam": Rays.of(RIG, "cam", rays)}, params)


def scene_of(cloud, cameras) -> Scene:
    lidar = LidarParams(judge="model")
    return Scene(RIG, cameras or {}, cloud, Plane(0.0, 0.0, -1.6), np.zeros((0, 3)), np.zeros(3), lidar)


CAR, MOVING = points(L, car_back(20.0, 0.0)), points(R, echoes(20.0, 0.0), rate_mps=3.0, own_mps=8.0)


def test_what_a_camera_sees_has_its_outline_and_the_distance_of_the_points():
    car = found(joined(CAR, MOVING), {"cam": seen(BOX)})
    assert car.camera.tolist() == ["cam"]
    assert car.xyxy_px.tolist() == [BOX]
    assert (car.label.tolist(), car.sources.tolist()) == (["car"], [7])
    # The middle of a car 4.2 m long and 1.55 m high.
    assert car.distance_m[0] == pytest.approx(np.hypot(22.1, 1.6 - 1.55 / 2), abs=0.05)
    assert car.range_rate_mps[0] == pytest.approx(3.0 - 8.0)


def test_what_no_camera_sees_is_outlined_by_its_points_down_to_the_ground():
    car = found(CAR, params=EarlyImageParams(min_score=0.01, margin_px=0.0))
    # 0.9 m to both sides at 20 m; from 1.2 m above the ground, 0.4 m below the camera, to the ground.
    assert car.xyxy_px[0] == pytest.approx([377.0, 309.5, 422.0, 339.5], abs=1e-6)
    assert car.sources.tolist() == [2]
    assert np.isnan(car.range_rate_mps[0])
    wider = found(CAR, params=EarlyImageParams(min_score=0.01, margin_px=4.0))
    # 5 px at this focal length; nothing is seen below the ground.
    assert wider.xyxy_px[0] == pytest.approx([372.0, 304.5, 427.0, 339.5], abs=1e-6)


def test_what_radar_alone_shows_is_outlined_by_its_box_in_space():
    car = found(MOVING, params=EarlyImageParams(min_score=0.01))
    assert car.sources.tolist() == [4]
    width, height = (car.xyxy_px[0, 2:] - car.xyxy_px[0, :2]).tolist()
    assert height / width == pytest.approx(1.6 / 1.8, abs=0.05)  # the back of a typical car
    assert car.xyxy_px[0, 3] == pytest.approx(339.5, abs=2.0)


def test_an_outline_is_drawn_toward_that_of_the_points():
    beside = [BOX[0] + 4, 309.5, BOX[2] + 4, 339.5]
    for share, moved in ((0.0, 0.0), (0.5, 2.0), (1.0, 4.0)):
        car = found(CAR, {"cam": seen(beside)}, EarlyImageParams(measured_share=share, margin_px=0.0))
        assert car.xyxy_px[0] == pytest.approx(np.subtract(beside, [moved, 0, moved, 0]), abs=1e-6)


def test_the_less_a_camera_is_sure_the_more_the_points_count():
    beside = [BOX[0] + 4, 309.5, BOX[2] + 4, 339.5]
    left = [
        float(found(joined(CAR, MOVING), {"cam": seen(beside, score=s)}, EarlyImageParams(margin_px=0)).xyxy_px[0, 0])
        for s in (0.9, 0.5, 0.35)
    ]
    assert left == sorted(left, reverse=True)
    assert left[0] == pytest.approx(beside[0] - 0.1 * 4)


@pytest.mark.parametrize(("score", "kept_at_px"), [(0.9, 30.0), (0.5, 0.0)])
def test_between_two_places_is_no_outline(score, kept_at_px):
    """Boxes 30 px beside points that are 45 px wide: an IoU of 0.2."""
    how, points_px = (
        EarlyImageParams(measured_share=0.0, weak_measured_share=0.3, margin_px=0.0, least_alike=0.1),
        377.0,
    )
    beside = [BOX[0] + 30, 309.5, BOX[2] + 30, 339.5]
    car = found(joined(CAR, MOVING), {"cam": seen(beside, score=score)}, how)
    assert (len(car), car.sources.tolist()) == (1, [7])
    assert car.xyxy_px[0, 0] == pytest.approx(points_px + kept_at_px)
    near = [BOX[0] + 10, 309.5, BOX[2] + 10, 339.5]  # 35 of 55 px
    car = found(joined(CAR, MOVING), {"cam": seen(near, score=score)}, how)
    drawn = 0.3 * (1 - min(score, LEAST) / LEAST)  # `seen` says how sure a camera must be
    assert car.xyxy_px[0, 0] == pytest.approx(points_px + 10 * (1 - drawn), abs=1.0)


def test_a_post_in_an_unsure_box_of_a_truck_is_no_truck():
    z = np.linspace(-1.5, -0.9, 12)
    post = points(L, np.column_stack([np.full(24, 24.0), np.tile([-0.3, 0.3], 12), np.repeat(z, 2)]))
    truck = {"cam": seen([357.0, 260.0, 442.0, 333.0], score=0.5, label="truck")}
    scene = scene_of(post, truck)
    candidates = find_candidates(scene, AS_SEEN)
    assert candidates.groups.observation.tolist() == [0]  # the box takes its points
    assert candidates.alone[0] < candidates.score[0]
    loose, strict = (replace(AS_SEEN, min_score=0.0, least_alike=least) for least in (0.0, 0.25))
    confirmed, apart = (fuse_in_images(scene, ["cam"], {}, how) for how in (loose, strict))
    assert (confirmed.sources.tolist(), apart.sources.tolist()) == ([3], [2])
    assert confirmed.score[0] == pytest.approx(candidates.score[0])
    assert apart.score[0] <= candidates.alone[0]
    sure = {"cam": seen([357.0, 260.0, 442.0, 333.0], score=0.9, label="truck")}
    assert fuse_in_images(scene_of(post, sure), ["cam"], {}, strict).sources.tolist() == [3]


def test_of_what_is_partly_hidden_points_show_less_of_the_width():
    """Points at the right third of an unsure box, as high as it: the car isn't elsewhere."""
    left, top, right, bottom = 332.0, 309.5, 422.0, 339.5
    how = EarlyImageParams(measured_share=0.0, weak_measured_share=0.3, margin_px=0.0)
    car = found(joined(CAR, MOVING), {"cam": seen([left, top, right, bottom], score=0.5)}, how)
    assert car.sources.tolist() == [7]
    assert left < car.xyxy_px[0, 0] < left + 0.3 * 45  # drawn toward the points, which begin 45 px to the right


@pytest.mark.parametrize(("x_m", "num"), [(47.0, 1), (80.0, 2)])
def test_parts_of_what_a_sure_camera_shows_whole_are_no_objects(x_m, num):
    """What stands 47 m away in the box of a truck whose back is 40 m away is of the truck; 80 m is behind it."""
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-1.2, 1.2, 9), np.linspace(-1.2, 1.2, 9)))
    back = points(L, np.column_stack([np.full(81, 40.0), y, z]))
    part = points(L, car_back(x_m, 0.01 * x_m, width_m=0.03 * x_m))
    moving = points(R, echoes(x_m, 0.01 * x_m), rate_mps=3.0)
    truck = {"cam": seen([380.5, 280.5, 417.5, 319.5], label="truck")}
    scene, how = scene_of(joined(back, part, moving), truck), EarlyImageParams(min_score=0.05, margin_px=0.0)
    assert len(choose(find_candidates(scene, how), how)) == 2  # they are two in space
    shown = fuse_in_images(scene, ["cam"], {}, how)
    assert shown.sources.tolist()[0] & int(Source.C)
    assert len(shown) == num


def test_what_only_a_camera_sees_keeps_its_score_and_a_guessed_distance():
    car = found(NOTHING, {"cam": seen(BOX, score=LEAST)})
    assert car.xyxy_px.tolist() == [BOX]
    assert car.score == pytest.approx(0.55)  # that of what a camera just reports
    assert car.sources.tolist() == [1]
    assert car.distance_m[0] == pytest.approx(22.0, abs=1.0)
    assert np.isnan(car.range_rate_mps[0])


def test_rays_that_go_on_behind_it_deny_what_only_a_camera_sees():
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-1.2, 2, 12)))
    wall = np.column_stack([np.full(len(y), 60.0), 2 * y, 2 * z])
    sure = {"cam": seen(BOX, score=0.98)}
    alone, denied = found(NOTHING, sure).score[0], found(NOTHING, sure, rays=wall).score[0]
    assert denied / (1 - denied) == pytest.approx(0.25 * alone / (1 - alone))
    assert len(found(NOTHING, {"cam": seen(BOX, score=LEAST)}, rays=wall)) == 0
    assert len(found(NOTHING, {"cam": seen(BOX, score=LEAST)}, rays=wall / 10)) == 1  # what is before it hides it


def test_what_a_camera_ought_to_see_and_doesnt_is_believed_less():
    def odds(factor, cameras):
        car = found(
            joined(CAR, MOVING), cameras, EarlyImageParams(min_score=0.0, margin_px=0.0, unseen_by_camera=factor)
        )
        return float(car.score[0] / (1 - car.score[0]))

    blind, looking = {}, {"cam": seen()}
    assert odds(0.1, blind) == pytest.approx(odds(1.0, blind))
    # Outlined with 45 x 30 px; of nine in ten cameras see the share that is large enough.
    large = 0.9 * (1 - np.exp(-np.sqrt(45 * 30) / 40))
    assert odds(0.1, looking) == pytest.approx((1 - 0.9 * large) * odds(1.0, looking))


def test_cameras_that_see_nothing_of_what_others_see_lose_their_say():
    fusion = EarlyImageFusion(("cam",), EarlyImageParams())
    scene, fresh = scene_of(joined(CAR, MOVING), {"cam": seen()}), EarlyImageFusion(("cam",), EarlyImageParams())
    scores = [float(fusion.fuse(scene, {}).score[0]) for _ in range(30)]
    assert scores == sorted(scores)
    assert scores[-1] > scores[0] + 0.01
    fusion.reset()
    assert float(fusion.fuse(scene, {}).score[0]) == float(fresh.fuse(scene, {}).score[0]) == scores[0]


def test_a_weak_box_counts_only_with_points():
    weak = {"cam": seen(BOX, score=0.4)}
    assert len(found(NOTHING, weak)) == 0
    assert found(joined(CAR, MOVING), weak).sources.tolist() == [7]


def test_sensors_show_together_what_none_of_them_shows_alone():
    """Four points and two moving echoes, 40 m away."""
    lidar = points(L, [[40.0, -0.8, -1.1], [40.0, 0.8, -1.1], [40.0, -0.8, -0.5], [40.0, 0.8, -0.5]])
    radar = points(R, [[40.2, 0.0, 0.0], [40.4, 0.1, 0.0]], rate_mps=5.0)
    weak = {"cam": seen([388.0, 299.5, 411.0, 319.5], score=0.4)}
    for cloud, cameras in ((lidar, None), (radar, None), (NOTHING, weak), (lidar, weak), (radar, weak)):
        assert len(found(cloud, cameras)) == 0
    two, three = found(joined(lidar, radar), {"cam": seen()}), found(joined(lidar, radar), weak)
    assert (two.sources.tolist(), three.sources.tolist()) == ([6], [7])
    assert three.score[0] > two.score[0]
    assert two.distance_m[0] == pytest.approx(42.1, abs=0.1)


def test_an_object_has_an_outline_in_each_image_that_sees_it():
    moved = [BOX[0] + 25, BOX[1], BOX[2] + 25, BOX[3]]  # 1 m to the left of the other camera, at 20 m
    both = found(CAR, {"cam": seen(BOX), "left": seen(moved, score=0.8)}, images=("cam", "left"))
    assert both.camera.tolist() == ["cam", "left"]
    assert both.xyxy_px.tolist() == [BOX, moved]
    assert both.sources.tolist() == [3, 3]
    one = found(CAR, {"cam": seen(BOX)}, images=("cam", "left"))
    assert one.camera.tolist() == ["cam", "left"]
    assert one.xyxy_px[1] == pytest.approx([moved[0] - 2.5, 307.0, moved[2] + 2.5, 339.5])  # by its points


def test_of_objects_in_one_place_of_an_image_the_surest_stays():
    two = CameraDetections(np.array([BOX, np.add(BOX, 2.0)]), np.array([0.7, 0.9]), np.array(["car"] * 2), LEAST)
    assert found(CAR, {"cam": two}).xyxy_px.tolist() == [np.add(BOX, 2.0).tolist()]


def test_what_is_behind_a_camera_is_in_no_image():
    assert len(found(points(L, car_back(-20.0, 0.0)), params=EarlyImageParams(min_score=0.01))) == 0


def test_nothing_has_the_same_fields():
    assert found(NOTHING).arrays().keys() == found(CAR, {"cam": seen(BOX)}).arrays().keys()


def test_the_rate_of_a_group_is_that_of_its_moving_echoes():
    still, unknown = points(R, [[20.0, 0, 0]] * 5, rate_mps=0.0, own_mps=8.0), points(R, [[20.0, 0, 0]], rate_mps=3.0)
    moving = points(R, [[20.0, 0, 0]] * 2, rate_mps=3.0, own_mps=8.0)

    def rates(*parts):
        cloud = joined(*parts)
        whole = Groups(np.arange(len(cloud)), np.array([0, len(cloud)]), np.array([-1]))
        return range_rates(cloud, whole).tolist()

    assert rates(CAR, still, moving) == [-5.0]
    assert rates(still, moving[:1]) == [-8.0]  # one echo may be a mistake
    assert np.isnan(rates(CAR, unknown)).all()  # how the radar moves isn't known


def test_the_order_of_a_cameras_boxes_changes_nothing():
    other = [100.0, 299.5, 145.0, 339.5]
    a, b = (found(joined(CAR, MOVING), {"cam": seen(*boxes)}) for boxes in ([BOX, other], [other, BOX]))
    for name, values in a.arrays().items():
        np.testing.assert_array_equal(b.arrays()[name], values)


def test_odds_of_what_a_camera_ought_to_see_and_doesnt_are_limited():
    def score(most, cameras):
        how = EarlyImageParams(min_score=0.0, margin_px=0.0, unseen_by_camera=1.0, most_unseen=most)
        return float(found(joined(CAR, MOVING), cameras, how).score[0])

    looked = 0.9 * (1 - np.exp(-np.sqrt(45 * 30) / 40))
    assert score(0.5, {"cam": seen()}) == pytest.approx(1 / (1 + np.exp(-0.5 / looked)))
    assert score(1000.0, {"cam": seen()}) > score(0.5, {"cam": seen()})
    assert score(0.5, {}) == score(1000.0, {})  # no camera looks


def test_the_edge_of_what_is_beside_an_image_is_no_object_in_it():
    right = 20.0 * (800 - 399.5) / 500  # [m] to the right 20 m ahead, the image ends there
    for inside, num in ((0.2, 0), (0.5, 1)):
        car = points(L, car_back(20.0, -right + 1.8 * (inside - 0.5)))
        assert len(found(car, params=EarlyImageParams(min_score=0.01))) == num


def test_a_camera_shows_points_that_are_in_its_place_of_the_image_though_they_are_too_far():
    """The box looks as if the car was 15.4 m away, so that it takes none of its points, 20 m away."""
    near = [370.25, 299.5, 428.75, 351.4]
    car = found(joined(CAR, MOVING), {"cam": seen(near)}, EarlyImageParams(margin_px=4.0))
    assert (len(car), car.sources.tolist()) == (1, [7])
    assert car.distance_m[0] == pytest.approx(22.1, abs=0.1)


def test_noisy_points_of_stereo_leave_the_shape_to_lidar():
    noise = np.random.Generator(np.random.Philox(5)).uniform(-1, 1, (60, 3)) * [1.5, 1.5, 0.3]
    stereo = replace(points(S, car_back(20.5, 0.9)[:1] + noise), exactness=np.full(60, 0.25))
    scenes = (scene_of(joined(CAR, *more, MOVING), {"cam": seen(BOX)}) for more in ((), (stereo,)))
    alone, both = (find_candidates(scene, EarlyParams()) for scene in scenes)
    assert both.counts.sources[0] == alone.counts.sources[0] | int(Source.S)
    assert both.boxes.center_m[0] == pytest.approx(alone.boxes.center_m[0], abs=1e-9)
    assert both.boxes.size_lwh_m[0] == pytest.approx(alone.boxes.size_lwh_m[0], abs=1e-9)


def test_objects_can_be_outlined_by_their_boxes_in_space():
    """A whole car is about as tall as the camera is high; the points of its back reach up to 1.2 m."""
    by_points, by_box = (found(CAR, params=EarlyImageParams(min_score=0.01, margin_px=0.0, outline=how)).xyxy_px[0]
                         for how in ("points", "boxes"))  # fmt: skip
    assert by_points[1] == pytest.approx(309.5)
    assert by_box[1] == pytest.approx(299.5, abs=2.0)
    assert by_box[3] == pytest.approx(by_points[3], abs=0.5)


def standing_car(x_m: float):
    """A dense radar's echoes of the back and the sides of a standing car."""
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.9, 0.9, 7), np.linspace(-1.1, -0.1, 5)))
    back = np.column_stack([np.full(len(y), x_m), y, z])
    side = np.column_stack([x_m + np.linspace(0.3, 4.0, 12), np.full(12, 0.9), np.full(12, -0.6)])
    xyz = np.concatenate([back, side])
    return replace(points(R, xyz, rate_mps=0.0, own_mps=8.0), height_m=xyz[:, 2] + 1.6)


@pytest.mark.parametrize("score", [0.45, 0.8])
def test_echoes_of_a_dense_radar_show_the_shape_of_what_a_camera_hardly_sees(score):
    """As in fog: no point of the LiDAR is on the car, and the camera alone wouldn't report it with a score of 0.45."""
    scene = scene_of(standing_car(20.0), {"cam": seen(BOX, score=score)})
    few = fuse_in_images(scene, ["cam"], {}, AS_SEEN)
    dense = fuse_in_images(replace(scene, tall_echoes=np.zeros((0, 3))), ["cam"], {}, AS_SEEN)
    assert len(few) == (score > LEAST)
    assert dense.sources.tolist() == [5]
    signs = np.column_stack([np.linspace(19.5, 24.5, 80), np.zeros(80), np.full(80, 4.0)])
    under = fuse_in_images(replace(scene, tall_echoes=signs), ["cam"], {}, AS_SEEN)
    assert len(under) == (score > LEAST)  # what goes on above the height of vehicles is none


def test_a_very_weak_box_leaves_points_that_show_a_shape():
    """One below half of the least score counts where there are echoes only."""
    weak = scene_of(CAR, {"cam": seen(BOX, score=0.2)})
    assert (find_candidates(weak, AS_SEEN).groups.observation == -1).all()
    half = scene_of(CAR, {"cam": seen(BOX, score=0.4)})
    assert find_candidates(half, AS_SEEN).groups.observation.tolist() == [0]
    radar = scene_of(standing_car(20.0), {"cam": seen(BOX, score=0.2)})
    assert find_candidates(radar, AS_SEEN).groups.observation.tolist() == [0]
