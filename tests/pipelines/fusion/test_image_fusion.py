import math
from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.sensors.image.places import CAMERA, RIG, back, cloud, wall

from fbench.pipelines.fusion.image import ImageFusionParams, ImageView, associate, fuse
from fbench.pipelines.fusion.reliability import CameraReliability
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.objects import spots
from fbench.pipelines.sensors.image.params import LidarImageParams
from fbench.pipelines.sensors.image.stage import SURE, ImageObservations, Rays, by_camera, by_points
from fbench.replay.data.boxes import Source

DEFAULT = LidarImageParams()
PARAMS = DEFAULT
CAR = [379.0, 288.0, 420.0, 319.5]
"""What a camera shows of a car whose back is 20 m ahead."""


def camera(*boxes, score=0.8, label="car", min_score=0.6):
    num = len(boxes)
    found = CameraDetections(np.reshape(boxes, (num, 4)), np.full(num, score), np.full(num, label), min_score)
    return by_camera(found, CAMERA)


def stereo(box, depth_m=20.0, score=1.0, exactness=0.5):
    """What a stereo pair shows of one vehicle."""
    column = {"xyxy_px": np.array([box]), "score": np.array([score]), "label": np.array(["car"])}
    known = {"distance_m": np.array([depth_m + 2.0]), "exactness": np.array([exactness])}
    return ImageObservations.of(Source.S, **column, depth_m=np.array([depth_m]), std=np.array([0.1]), **known)


def view(camera=None, lidar=None, radar=None, stereo=None) -> ImageView:
    """What a camera and a stereo pair (their observations), LiDAR and radar (clouds) see."""
    clouds = ((Source.L, lidar), (Source.R, radar))
    parts = [by_points(spots(RIG, "cam", one, PARAMS), kind) for kind, one in clouds if one is not None]
    parts += [one for one in (camera, stereo) if one is not None]
    rays = None if lidar is None else Rays.of(RIG, "cam", lidar.xyz)
    return ImageView(RIG, "cam", ImageObservations.join(parts), camera is not None, rays)


def odds(probability):
    return probability / (1 - probability)


def found(*args, min_score=0.3, **sensors):
    boxes = fuse(view(*args, **sensors), ImageFusionParams())
    return boxes[boxes.score >= min_score]


LIDAR, RADAR = cloud(back(20), wall()), cloud(back(20.1, width_m=1.5), rate_mps=4.0)


def test_one_object_of_three_sensors():
    car = found(camera(CAR), lidar=LIDAR, radar=RADAR)
    assert car.xyxy_px[0] == pytest.approx(CAR, abs=0.6)  # drawn a little towards the points
    assert (car.label.tolist(), car.sources.tolist()) == (["car"], [7])
    assert car.distance_m[0] == pytest.approx(22.1, abs=0.2)
    assert car.range_rate_mps.tolist() == [-6.0]
    assert car.score[0] > 0.9


@pytest.mark.parametrize(
    ("sensors", "bits"),
    [({"lidar": LIDAR}, 2), ({"radar": RADAR}, 4), ({"lidar": LIDAR, "radar": RADAR}, 6)],
    ids=["lidar", "radar", "both"],
)
def test_what_no_camera_sees_is_kept(sensors, bits):
    car = found(**sensors)
    assert (car.label.tolist(), car.sources.tolist()) == (["car"], [bits])
    assert car.distance_m[0] == pytest.approx(22.1, abs=0.3)


def test_a_camera_alone_guesses_the_distance_by_size():
    car = found(camera(CAR))
    assert car.sources.tolist() == [1]
    assert car.distance_m[0] == pytest.approx(400 * 1.55 / 31.5 + 2, abs=0.3)
    assert np.isnan(car.range_rate_mps[0])


def test_an_object_through_which_rays_go_is_believed_less():
    seen = found(camera(CAR), lidar=cloud(wall()))
    assert odds(seen.score[0]) == pytest.approx(0.25 * odds(found(camera(CAR)).score[0]))
    hidden = found(camera(CAR), lidar=cloud(back(8, width_m=6.0, top_m=4.0)))
    assert hidden.score[hidden.sources == 1].tolist() == found(camera(CAR)).score.tolist()


def test_radar_behind_an_object_says_nothing_against_it():
    alone = found(camera(CAR)).score.tolist()
    seen = found(camera(CAR), radar=cloud(wall()))
    assert seen.score[seen.sources == 1].tolist() == alone


def test_two_objects_at_different_depths_stay_two():
    boxes = found(camera(CAR), lidar=cloud(back(45, 1.0, top_m=2.0, width_m=3.0)))
    assert sorted(boxes.sources.tolist()) == [1, 2]


def test_the_best_pair_is_joined_first_whichever_sensors_it_is_of():
    one = camera(CAR, [385.0, 288, 440, 319.5])
    pairs = associate(ImageObservations.join([one, camera(CAR)]), 0.2)
    assert [len(rows) for rows in pairs] == [1, 1, 1]  # boxes of one sensor are never joined
    lidar = by_points(spots(RIG, "cam", LIDAR, PARAMS), Source.L)
    both = ImageObservations.join([one, lidar[lidar.score > 0.3]])
    joined = next(rows for rows in associate(both, 0.2) if len(rows) == 2)
    assert both.xyxy_px[joined[0]].tolist() == CAR


def test_parts_of_what_a_camera_shows_whole_are_left_out():
    halves = cloud(back(20, -0.6, width_m=0.5), back(20, 0.6, width_m=0.5), rate_mps=2.0)
    assert found(camera(CAR), lidar=LIDAR, radar=halves).sources.tolist() == [7]


def test_the_order_of_boxes_changes_nothing():
    two = [CAR, [100.0, 290, 150, 330]], [[100.0, 290, 150, 330], CAR]
    a, b = (found(camera(*boxes), lidar=LIDAR) for boxes in two)
    assert a.xyxy_px.tolist() == b.xyxy_px.tolist()
    assert a.score.tolist() == b.score.tolist()


def test_nothing_seen_has_the_same_fields():
    assert set(found().arrays()) == set(found(camera(CAR)).arrays())
    assert len(found(lidar=cloud())) == 0


def test_points_that_are_no_object_themselves_say_nothing():
    car = found(camera(CAR), lidar=cloud(back(20)[::40], wall(40)))
    assert car.sources.tolist() == [1]
    assert car.distance_m.tolist() == found(camera(CAR)).distance_m.tolist()


def test_what_a_camera_that_sees_well_doesnt_see_is_believed_less():
    nothing = camera()
    seen = view(nothing, lidar=LIDAR, radar=RADAR)
    day, night = (fuse(seen, ImageFusionParams(), trust)[:1] for trust in (1.0, 0.5))
    blind = odds(fuse(view(lidar=LIDAR, radar=RADAR), ImageFusionParams(), 1.0).score[0])
    width, height = (day.xyxy_px[0, 2:] - day.xyxy_px[0, :2]).tolist()
    large = 1 - math.exp(-math.sqrt(width * height) / 40)  # so many of its size a camera sees
    assert odds(day.score[0]) == pytest.approx((1 - 0.9 * large) * blind)
    assert odds(night.score[0]) == pytest.approx((1 - 0.9 * large / 2) * blind)
    assert day.score[0] > 0.5  # what LiDAR and radar both see stays


def test_one_sensor_alone_is_believed_where_cameras_see_badly():
    seen = view(camera(), lidar=LIDAR)
    day, night = (float(fuse(seen, ImageFusionParams(), trust).score[0]) for trust in (1.0, 0.1))
    assert day < 0.6 < night


def test_weak_boxes_count_where_others_confirm_them():
    weak = camera(CAR, score=0.3)
    assert len(found(weak)) == 0
    assert len(found(weak, lidar=cloud(wall()))) == 0
    alone = found(camera(), lidar=LIDAR)
    both = found(weak, lidar=LIDAR)
    assert both.sources.tolist() == [3]
    assert both.score[0] > alone.score[0]
    assert found(camera(CAR, score=0.5), lidar=LIDAR).score[0] > both.score[0]


def test_a_weak_box_never_says_less_than_none():
    for trust in (0.0, 0.5, 1.0):
        none, weak = (
            fuse(view(seen, lidar=LIDAR), ImageFusionParams(), trust).score[0]
            for seen in (camera(), camera(CAR, score=0.05))
        )
        assert weak > none - 1e-3  # its outline is a little larger, so that a camera ought to see it rather


def test_weak_boxes_take_what_sure_ones_leave():
    beside = [383.0, 286.0, 424.0, 319.5]
    for sure, weak in ((CAR, beside), (beside, CAR)):  # also where the weak one fits better
        both = ImageObservations.join([camera(sure, score=0.7), camera(weak, score=0.5)])
        cars = found(both, lidar=LIDAR, radar=RADAR)
        assert cars.sources.tolist() == [7]
        assert np.abs(cars.xyxy_px[0] - sure).max() < np.abs(cars.xyxy_px[0] - weak).max()


def test_the_less_a_camera_is_sure_the_more_counts_the_outline_of_the_points():
    points, beside = found(lidar=LIDAR).xyxy_px[0], [385.0, 284.0, 426.0, 319.5]
    off = [
        float(np.abs(found(camera(beside, score=s), lidar=LIDAR).xyxy_px[0] - points).max()) for s in (0.8, 0.5, 0.3)
    ]
    assert off == sorted(off, reverse=True)
    assert off[0] == pytest.approx(0.9 * np.abs(np.subtract(beside, points)).max())


@pytest.mark.parametrize("min_score", [0.3, 0.6])
def test_scores_of_cameras_count_as_against_their_own_least(min_score):
    at_least = camera(CAR, score=min_score, min_score=min_score)
    assert at_least.score.tolist() == pytest.approx([SURE])
    assert not at_least.weak.any()
    assert found(at_least).score.tolist() == pytest.approx([SURE])
    assert camera(CAR, score=min_score - 0.01, min_score=min_score).weak.all()


def test_a_wrong_class_doesnt_make_two_objects_of_one():
    tall = camera(CAR, label="truck")  # would be twice as far away
    assert found(tall, lidar=LIDAR).sources.tolist() == [3]


def test_of_objects_in_one_place_the_likeliest_stays():
    two = ImageObservations.join([camera(CAR, score=0.7), camera([381.0, 288, 422, 319.5])])
    assert found(two).xyxy_px.tolist() == [[381.0, 288, 422, 319.5]]


def test_trust_in_cameras_follows_what_lidar_and_radar_see_together():
    trust = CameraReliability()
    assert trust.share == pytest.approx(0.9)
    sources = found(camera(CAR), lidar=LIDAR, radar=RADAR)
    unseen = replace(sources, sources=np.array([6], np.uint8))
    trust.learn(replace(sources, sources=np.array([2], np.uint8)))  # seen by one sensor: tells nothing
    assert trust.share == pytest.approx(0.9)
    trust.learn(sources)
    sure = 2 * float(sources.score[0]) - 1
    assert trust.share == pytest.approx((18 * 0.97**2 + sure) / (20 * 0.97**2 + sure))
    for _ in range(200):
        trust.learn(unseen)
    assert trust.share < 0.05
    trust.reset()
    assert trust.share == pytest.approx(0.9)


def test_evidence_of_stereo_counts_by_its_exactness():
    """Log-odds go from those of the prior, 0.3, to those of its weight, 0.7, by that share: half the way is 0.5."""
    scores = [fuse(view(stereo=stereo(CAR, exactness=e)), ImageFusionParams()).score[0] for e in (0.0, 0.5, 1.0)]
    assert scores == pytest.approx([0.3, 0.5, 0.7])
    car = found(camera(CAR, score=0.6), stereo=stereo(CAR, exactness=1.0))  # at min_score, which means 0.5
    assert odds(car.score[0]) == pytest.approx(odds(0.5) / odds(0.3) * odds(0.7))
    assert (car.sources.tolist(), car.distance_m.tolist()) == ([9], [22.0])


def test_beside_lidar_stereo_changes_nothing_but_the_sources():
    for score in (0.1, 1.0):
        with_pair, without = (found(camera(CAR), lidar=LIDAR, stereo=own) for own in (stereo(CAR, score=score), None))
        assert (with_pair.sources.tolist(), without.sources.tolist()) == ([11], [3])
        for name in ("xyxy_px", "score", "distance_m"):
            np.testing.assert_array_equal(with_pair.arrays()[name], without.arrays()[name])


def test_stereo_never_outvotes_rays_of_a_lidar_nor_an_odd_shape_what_radar_sees():
    free = cloud(wall())
    car = found(camera(CAR), lidar=free, stereo=stereo(CAR, exactness=1.0))
    assert np.count_nonzero(car.sources == 9) == 1
    assert car.score[car.sources == 9] == pytest.approx(found(camera(CAR), lidar=free).score[0])
    alone = found(radar=RADAR)
    assert found(radar=RADAR, stereo=stereo(CAR, score=0.01)).score == pytest.approx(alone.score)
    assert alone.score[0] < found(radar=RADAR, stereo=stereo(CAR)).score[0]


def test_the_outline_is_drawn_to_that_of_stereo_by_its_exactness():
    weak, wide = camera(CAR, score=0.01), [369.0, 288.0, 430.0, 319.5]
    left = [fuse(view(weak, stereo=stereo(wide, exactness=e)), ImageFusionParams()).xyxy_px[0, 0] for e in (0.5, 1.0)]
    assert left == pytest.approx([374.0, 369.0], abs=0.5)


def test_a_part_that_only_stereo_shows_of_what_radar_sees_is_left_out():
    parts = [stereo(CAR, exactness=1.0), stereo([403.0, 288.0, 420.0, 319.5], exactness=1.0)]
    assert found(radar=RADAR, stereo=ImageObservations.join(parts)).sources.tolist() == [12]
    farther = stereo([403.0, 288.0, 420.0, 319.5], depth_m=40.0, exactness=1.0)
    assert found(radar=RADAR, stereo=ImageObservations.join([parts[0], farther])).sources.tolist() == [12, 8]
