"""Images in weather, against Koschmieder's law at known distances."""

import numpy as np
import pytest
from tests.replay.conditions.camera.sites import (
    HEIGHT_M,
    RIG,
    SIZE,
    F,
    edit,
    even,
    image,
    pixels_of,
    site,
    street,
    wall,
)
from tests.replay.fakes import FakeLog

from fbench.replay.conditions.camera.depth import distances, gray_cells
from fbench.replay.conditions.camera.fog import AIRLIGHT, FogWithoutDepth
from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.weather import Weather, snow_extinction_per_m
from fbench.replay.contracts.conditions import Part
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import CameraModel, Rig

L = 255 * AIRLIGHT
FOG = Weather(visibility_m=100)
EMPTY = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))


def in_weather(pixels, weather, at=None, sensor="left"):
    return pixels_of(disturb_image(image(pixels, sensor), weather, at or site(sensor)))


def depth_of(pixels, at):
    gray = gray_cells(pixels)
    assert gray.shape == (SIZE[1], SIZE[0])
    return distances(gray, SIZE, at)


@pytest.mark.parametrize("alpha", [0.005, 0.01, 0.02, 0.03, 0.06])
def test_fog_on_flat_ground_follows_its_distance(alpha):
    """d = h f / (v - v0) straight ahead, along the ray; the image is even, so that nothing but distance counts."""
    foggy = in_weather(even(40), Weather(visibility_m=np.log(20) / alpha))
    for row in (160, 190, 220):
        down = (row - 119.5) / F
        distance_m = HEIGHT_M / down * np.sqrt(1 + down * down)
        expected = 40 * np.exp(-alpha * distance_m) + L * (1 - np.exp(-alpha * distance_m))
        assert foggy[row, 160] == pytest.approx([expected] * 3, abs=1.5)


@pytest.mark.parametrize("range_m", [10.0, 30.0, 80.0])
def test_fog_before_what_lidar_sees(range_m):
    foggy = in_weather(even(40), FOG, site(cloud=wall(range_m)))
    t = 0.05 ** ((range_m - 1) / 100)  # the camera is 1 m ahead
    assert foggy[110, 160] == pytest.approx([40 * t + L * (1 - t)] * 3, abs=2)


def test_fog_is_a_matter_of_distance_not_a_veil():
    left, right = wall(10, side=1), wall(80, side=-1)
    cloud = PointCloud("lidar", 0, 0, np.concatenate([left.xyz, right.xyz]))
    foggy = in_weather(even(40), FOG, site(cloud=cloud)).astype(int)
    assert foggy[110, 240].min() - foggy[110, 80].max() > 80


def test_where_lidar_looks_and_finds_nothing_it_is_far():
    """A street between two houses: no echo in the middle."""
    left, right = wall(20, side=1), wall(20, side=-1)
    xyz = np.concatenate([left.xyz[left.xyz[:, 1] > 8], right.xyz[right.xyz[:, 1] < -8]])
    d = depth_of(street(), site(cloud=PointCloud("lidar", 0, 0, xyz)))
    assert d[115, 160] > 200
    assert d[115, 60] == pytest.approx(np.sqrt(19**2 + (19 * 99.5 / F) ** 2), rel=0.05)


def test_above_the_view_of_lidar_houses_go_on_and_sky_is_far():
    cloud = wall(20, high_deg=2)
    assert depth_of(street(), site(cloud=cloud))[20, 160] < 40
    bright = street() // 2
    bright[:80] = 230
    d = depth_of(bright, site(cloud=cloud))
    assert d[20, 160] == pytest.approx(300)
    assert d[110, 160] < 25
    assert in_weather(bright, FOG, site(cloud=cloud))[20, 160] == pytest.approx([L] * 3, abs=1)


def test_ground_is_found_though_the_body_is_tilted():
    """As where the body's axes are those of a radar: 2 degrees of roll, 1.2 m above the ground."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-28, 28, (2, 6000))
    ground = np.stack([x, y, np.tan(np.radians(2)) * y - 1.2 - 2.0], axis=1)
    cloud = PointCloud("lidar", 0, 0, ground[np.hypot(x, y) < 28].astype(np.float32))
    behind = PointCloud("lidar", 0, 0, cloud.xyz[cloud.xyz[:, 0] < 0])  # not in the image, but of the same ground
    d = depth_of(street(), site(cloud=behind))
    height_m = HEIGHT_M + 1.2 - np.tan(np.radians(2)) * 0.2
    assert d[200, 160] == pytest.approx(height_m / (80.5 / F) * np.sqrt(1 + (80.5 / F) ** 2), rel=0.02)


def test_both_cameras_of_a_pair_see_the_same_fog():
    pixels = street()
    for cloud in (None, wall(25)):
        left, right = (depth_of(pixels, site(sensor, cloud=cloud)) for sensor in ("left", "right"))
        inner = np.s_[10:-10, 20:-20]
        np.testing.assert_allclose(left[inner], right[inner], rtol=0.05)
        a, b = (in_weather(pixels, FOG, site(s, cloud=cloud), s).astype(int) for s in ("left", "right"))
        assert np.abs(a - b)[inner].max() <= 4


@pytest.mark.parametrize("weather", [Weather(), Weather(water_mm=1.2), Weather(visibility_m=20_000, lux=1_000)])
def test_clear_days_change_nothing(weather):
    given = image(street())
    assert disturb_image(given, weather, site(cloud=wall(20))) is given


def test_fog_lies_between_the_image_and_the_airlight():
    pixels = street().astype(int)
    foggy = in_weather(pixels, FOG, site(cloud=wall(30))).astype(int)
    assert (foggy >= np.minimum(pixels, round(L)) - 1).all()
    assert (foggy <= np.maximum(pixels, round(L)) + 1).all()


@pytest.mark.parametrize(
    "at",
    [
        site(rig=Rig({}, {}, frozenset({"left"}))),
        site(rig=Rig(RIG.mounts, {}), cloud=wall(20)),
        site(rig=Rig(RIG.mounts, {"left": CameraModel(np.diag([160.0, 160, 1]), SIZE, "no_such_lens", np.ones(3))})),
        site(cloud=EMPTY),
        site(cloud=PointCloud("lidar", 0, 0, np.full((500, 3), np.nan, np.float32))),
        site(cloud=PointCloud("stranger", 0, 0, wall(20).xyz)),
    ],
    ids=["bare", "no-intrinsics", "unknown-lens", "empty-cloud", "nan-cloud", "lidar-without-mount"],
)
def test_without_calibration_or_cloud_the_ground_is_flat(at):
    foggy = in_weather(even(40), FOG, at).astype(int)
    assert 40 < foggy[230, 160, 0] < foggy[150, 160, 0] < foggy[20, 160, 0] == round(L - (L - 40) * 0.05**3)


def test_a_wide_lens_sees_fog_too():
    lens = CameraModel(K := np.array([[100.0, 0, 159.5], [0, 100, 119.5], [0, 0, 1]]), SIZE, "fisheye", np.zeros(4))
    rig = Rig(RIG.mounts, {"left": lens})
    d = depth_of(street(), site(rig=rig, cloud=wall(25)))
    angle = 60 / K[0, 0]  # equidistant: the angle to the axis is that of pixels to the center
    assert d[119, 219] == pytest.approx(24 / np.cos(angle), rel=0.05)
    assert np.isfinite(d).all()


WEATHERS = [
    FOG,
    Weather(rain_mm_h=25),
    Weather(snow_mm_h=9),
    Weather(lux=3),
    Weather(visibility_m=200, rain_mm_h=5, snow_mm_h=2, lux=30),
]


@pytest.mark.parametrize("weather", WEATHERS, ids=["fog", "rain", "snow", "night", "all"])
@pytest.mark.parametrize("size", [(1, 1), (7, 1), (1, 9), (33, 21)])
def test_tiny_images_keep_their_size(weather, size):
    result = disturb_image(image(even(90, size)), weather, site(cloud=wall(20)))
    assert result.size_wh == size
    assert pixels_of(result).shape == (size[1], size[0], 3)


@pytest.mark.parametrize("weather", WEATHERS, ids=["fog", "rain", "snow", "night", "all"])
def test_gray_images_stay_gray(weather):
    result = pixels_of(disturb_image(image(street()[..., 0]), weather, site(cloud=wall(20))))
    assert (result == result[..., :1]).all()
    assert (result[..., 0] != street()[..., 0]).any()


@pytest.mark.parametrize("weather", WEATHERS, ids=["fog", "rain", "snow", "night", "all"])
def test_equal_messages_and_seeds_give_equal_images_and_inputs_stay(weather):
    given, cloud = image(street()), wall(20)
    before = given.data, cloud.xyz.copy()
    first, again = (disturb_image(given, weather, site(cloud=cloud)) for _ in range(2))
    assert first.data == again.data != given.data
    assert given.data == before[0]
    np.testing.assert_array_equal(cloud.xyz, before[1])
    assert (first.stamp_ns, first.log_ns, first.sensor) == (given.stamp_ns, given.log_ns, given.sensor)


def test_what_cannot_be_decoded_passes():
    broken = Image("left", 0, 0, b"\xff\xd8broken", "jpeg", SIZE)
    assert disturb_image(broken, FOG, site()) is broken


def test_rain_and_snow_are_drawn_anew_for_every_image_and_camera():
    for weather in (Weather(rain_mm_h=25), Weather(snow_mm_h=9)):
        drawn = {
            disturb_image(image(even(90), sensor, stamp), weather, site(sensor)).data
            for sensor in ("left", "right")
            for stamp in (0, 100)
        }
        assert len(drawn) == 4


def test_more_rain_covers_more_and_dims():
    shares, means = [], []
    for rate in (2.0, 5.0, 10.0, 25.0, 50.0):
        wet = in_weather(even(0), Weather(rain_mm_h=rate), site(cloud=wall(5))).astype(int)
        shares.append((wet[..., 0] > np.median(wet) + 3).mean())
        means.append(in_weather(even(220), Weather(rain_mm_h=rate), site(cloud=wall(5))).mean())
    assert (np.diff(shares) > 0).all()
    assert (np.diff(means) < 0).all()


def test_streaks_fall_and_slant_by_fifteen_degrees_at_most():
    """The gradient of an image of streaks lies across them."""
    wet = in_weather(even(0), Weather(rain_mm_h=10), site(cloud=wall(5)))[..., 0].astype(float)
    gy, gx = np.gradient(wet)
    slope = 0.5 * np.arctan2(2 * (gx * gy).sum(), (gx * gx - gy * gy).sum())
    assert abs(np.degrees(slope)) < 16


def test_color_fades_in_rain():
    colored = even(0)
    colored[:] = (200, 60, 60)
    wet = in_weather(colored, Weather(rain_mm_h=50), site(cloud=wall(2)))
    calm = np.median(wet[90:230].reshape(-1, 3), axis=0)  # where LiDAR's wall is
    assert calm[0] - calm[1] == pytest.approx(0.7 * 0.7 * 140, abs=4)


def test_snow_hides_more_the_more_falls():
    means = [in_weather(even(60), Weather(snow_mm_h=rate)).mean() for rate in (0.1, 2.24, 4.82, 8.85, 34.97, 130)]
    assert (np.diff(means) > 0).all()
    assert snow_extinction_per_m(10) == pytest.approx(np.pi * 7.6e-3 * 10**-0.87 / (2.55 * 10**-0.48) ** 3, rel=0.01)


def test_light_comes_last_fog_is_dark_by_night():
    day = in_weather(even(40), FOG)
    night = in_weather(even(40), Weather(visibility_m=100, lux=3))
    assert day[20, 160, 0] > 190
    assert night[:60].mean() < 110


def test_fog_without_depth_keeps_the_brightest_and_its_place():
    pixels = street()
    foggy = edit(FogWithoutDepth(), image(pixels), 3)
    assert foggy.max() <= pixels.max()
    np.testing.assert_array_equal(edit(FogWithoutDepth(), image(pixels, stamp_ns=5), 3), foggy)
    assert edit(FogWithoutDepth(), image(even(0)), 5).max() == 0


class Probe:
    """Notes the cloud that each image is given."""

    version, kinds, levels = 1, ("camera",), {}

    def __init__(self):
        self.seen = []

    def disturb(self, message, level, site):
        self.seen.append(None if site.cloud is None else int(site.cloud.stamp_ns))
        return (message,)


def test_images_get_the_cloud_of_their_log_time_though_they_come_first():
    jpeg, of_images, of_clouds = encode_jpeg(even(50)), (0, 10**9, 2 * 10**9), (10**9, 2 * 10**9 + 1)
    images = [Image("left", s, s, jpeg, "jpeg", SIZE) for s in of_images]
    clouds = [PointCloud("lidar", s, s, np.ones((1, 3), np.float32)) for s in of_clouds]
    log, probe = FakeLog([*images, *clouds], rig=RIG), Probe()
    reader = DisturbedReader(log, Disturbance((Part("probe", probe),)), Effects())
    assert [m.log_ns for m in reader.messages()] == sorted((*of_images, *of_clouds))
    assert probe.seen == [None, 10**9, None]
