"""Recorded clouds in fog, rain and snow, and above wet ground."""

import numpy as np
import pytest
from scipy.stats import beta
from tests.replay.conditions.sites import QUARTER_LEFT, along_x, bytes_of, cloud, fields_of, site, street

from fbench.replay.conditions.lidar.echoes import power_floor, rain_drops, snow_flakes
from fbench.replay.conditions.lidar.ground import find_ground, wet_share
from fbench.replay.conditions.lidar.weather import disturb_cloud, receive
from fbench.replay.conditions.weather import Weather, extinction_per_m

CLEAR = np.log(20) / 20_000
SNOWS = (2.24, 4.82, 8.85, 34.97, 130.0)


def ranges(points):
    return np.sqrt((points.xyz.astype(np.float64) ** 2).sum(axis=1))


def bright(range_m):
    """Targets along x that reflect all, and some so faint and far that the sensor must be very sensitive."""
    num = len(range_m) // 20
    intensity = np.concatenate([np.ones(len(range_m)), np.full(num, 1e-3)])
    return cloud(along_x(np.concatenate([range_m, np.full(num, 400.0)])), intensity)


@pytest.mark.parametrize(
    ("alpha", "switch_m"), [(0.005, 259.8), (0.01, 150.6), (0.02, 86.5), (0.03, 62.4), (0.06, 35.6)]
)
def test_beams_longer_than_the_switch_become_fog(alpha, switch_m):
    """r* of the anchors' table, by which a density of fog with another's backscatter shows, too (defect 1)."""
    range_m = np.linspace(20, 300, 30_000)
    new_m = ranges(disturb_cloud(bright(range_m), Weather(visibility_m=np.log(20) / alpha), site()))
    is_fog = new_m < 15
    assert new_m[~is_fog].max() == pytest.approx(switch_m, abs=0.06)
    assert is_fog.sum() == (range_m > new_m[~is_fog].max() + 1e-4).sum()
    scatter = (new_m[is_fog] - 4.66) / 10
    assert scatter.mean() == pytest.approx(beta(2, 20).mean(), abs=0.01)


def test_near_targets_in_fog_keep_their_place_and_lose_by_beer_and_lambert():
    range_m = np.linspace(1, 30, 400)
    before = cloud(along_x(range_m), np.full(400, 0.8))
    result = disturb_cloud(before, Weather(visibility_m=100.0), site())
    np.testing.assert_array_equal(result.xyz, before.xyz[: len(result.xyz)])
    alpha = np.log(20) / 100
    expected = 0.8 * np.exp(-2 * (alpha - CLEAR) * range_m)
    np.testing.assert_allclose(result.intensity, expected[: len(result.xyz)], rtol=1e-5)


@pytest.mark.parametrize("scale", [1.0, 255.0, 65535.0])
def test_intensities_stay_in_the_sensors_unit(scale):
    base = street()
    share = base.intensity.astype(np.float64) / base.intensity.max()
    results = [
        disturb_cloud(cloud(base.xyz, share * full), Weather(visibility_m=80.0), site()) for full in (1.0, scale)
    ]
    assert results[0].xyz.tobytes() == results[1].xyz.tobytes()
    np.testing.assert_allclose(results[1].intensity, results[0].intensity * scale, rtol=1e-5)
    assert results[1].intensity.max() <= scale


def test_weak_echoes_are_lost_to_the_noise_not_just_dimmed():
    """Defect 3 of reference code: returns of rounded intensity 0 stay forever."""
    base = street()
    result = disturb_cloud(base, Weather(visibility_m=50.0), site())
    assert len(result.xyz) < 0.95 * len(base.xyz)
    far = ranges(result) > 15
    floor = min(power_floor(), np.quantile(base.intensity / ranges(base) ** 2, 0.0019))
    assert (result.intensity[far] / ranges(result)[far] ** 2 > 0.99 * floor).all()


@pytest.mark.parametrize("weather", [Weather(visibility_m=10.0), Weather(rain_mm_h=300.0), Weather(snow_mm_h=300.0)])
def test_points_stay_on_their_beams_before_their_targets(weather):
    """Defect 2: factors that throw near points to infinity, or mirror them."""
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(5000, 3))
    unit /= np.sqrt((unit**2).sum(axis=1))[:, None]
    range_m = np.concatenate([rng.uniform(0.05, 5, 2500), rng.uniform(5, 120, 2500)])
    before = cloud(unit * range_m[:, None], rng.uniform(0, 1, 5000), ring=np.arange(5000, dtype=np.uint16))
    after = disturb_cloud(before, weather, site())
    assert np.isfinite(after.xyz).all()
    assert len(after.xyz)
    along = (after.xyz * unit[after.ring]).sum(axis=1)
    noise = 0.0 if weather.rain_mm_h + weather.snow_mm_h == 0 else 0.5
    assert (along >= -1e-6).all()
    assert (along <= range_m[after.ring] * 1.000001 + noise).all()
    np.testing.assert_allclose(along, ranges(after), atol=1e-4)


@pytest.mark.parametrize("name", ["visibility_m", "rain_mm_h", "snow_mm_h"])
def test_thicker_weather_leaves_fewer_targets(name):
    base, left = street(), []
    for value in {"visibility_m": (599.0, 300.0, 150.0, 100.0, 50.0), "rain_mm_h": (2, 5, 10, 25, 50),
                  "snow_mm_h": SNOWS}[name]:  # fmt: skip
        after = disturb_cloud(cloud(base.xyz, base.intensity, ring=np.arange(20_000).astype(np.uint16)),
                              Weather(**{name: float(value)}), site())  # fmt: skip
        off = np.abs(ranges(after) - ranges(base)[after.ring])
        left.append(int((off < 0.5).sum()))
    assert left[0] < 20_000
    assert (np.diff(left) < 0).all()


def test_rain_and_snow_put_points_into_the_air_near_the_sensor():
    base = cloud(along_x(np.full(20_000, 45.0)), np.full(20_000, 0.08))
    for weather, least in ((Weather(rain_mm_h=25.0), 50), (Weather(snow_mm_h=35.0), 500)):
        near = ranges(disturb_cloud(base, weather, site())) < 20
        assert near.sum() > least


def test_snow_is_of_ice_and_of_flakes():
    """Defect 12: snow that reflects like water. N0, Lambda and n of LISA; extinction pi N0 / Lambda^3."""
    flakes = snow_flakes(8.85)
    assert flakes.per_m3_mm == pytest.approx(7600 * 8.85**-0.87)
    assert flakes.slope_per_mm == pytest.approx(2.55 * 8.85**-0.48)
    assert flakes.reflectance == pytest.approx((0.3031 / 2.3031) ** 2)
    assert rain_drops(1).reflectance == pytest.approx((0.328 / 2.328) ** 2)
    for rate in SNOWS:
        grid = np.linspace(0, 200 * rate**0.48, 2_000_001)
        direct = np.sum(7600 * rate**-0.87 * np.exp(-2.55 * rate**-0.48 * grid) * np.pi / 2 * grid**2) * grid[1] * 1e-6
        assert extinction_per_m(Weather(snow_mm_h=rate)) - CLEAR == pytest.approx(direct, rel=1e-3)
        assert extinction_per_m(Weather(snow_mm_h=rate)) - CLEAR == pytest.approx(1.44e-3 * rate**0.57, rel=0.01)


def test_fog_and_rain_together_are_both_of_one_after_the_other():
    """Extinctions add up, so that targets keep what both leave; what is left of the drops is as by rain alone."""
    range_m = np.linspace(2, 30, 4000)
    before = cloud(along_x(range_m), np.full(4000, 0.9), ring=np.arange(4000).astype(np.uint16))
    fog, rain = Weather(visibility_m=200.0), Weather(rain_mm_h=20.0)
    both = disturb_cloud(before, Weather(visibility_m=200.0, rain_mm_h=20.0), site())
    in_turn = disturb_cloud(disturb_cloud(before, fog, site()), rain, site())
    common, a, b = np.intersect1d(both.ring, in_turn.ring, return_indices=True)
    target = np.abs(np.stack([ranges(both)[a], ranges(in_turn)[b]]) - range_m[common]).max(axis=0) < 0.3
    assert target.mean() > 0.99
    np.testing.assert_allclose(both.intensity[a][target], in_turn.intensity[b][target], rtol=0.05)
    assert len(both.xyz) == pytest.approx(len(in_turn.xyz), rel=0.02)


def test_recorded_equals_simulated_weather():
    """A cloud of clear air that is disturbed has the echoes that the same beams receive in the weather."""
    rng = np.random.default_rng(3)
    range_m, reflectivity = rng.uniform(3, 80, 5000), rng.uniform(0.05, 0.9, 5000)
    floor, weather = 1e-7, Weather(visibility_m=120.0)
    clear_m, clear, _ = receive(range_m, reflectivity, Weather(), floor, np.random.default_rng(0))
    assert np.isfinite(clear_m).all()
    recorded = cloud(along_x(range_m), clear, ring=np.arange(5000).astype(np.uint16))
    after = disturb_cloud(recorded, weather, site())
    at_m, power, is_fog = receive(range_m, reflectivity, weather, floor, np.random.default_rng(0))
    hard = ~is_fog[after.ring]
    np.testing.assert_allclose(ranges(after)[hard], at_m[after.ring][hard], rtol=1e-5)
    np.testing.assert_allclose(after.intensity[hard], power[after.ring][hard], rtol=1e-4)


def test_clouds_without_intensity_have_grey_targets():
    base = street()
    bare = disturb_cloud(cloud(base.xyz), Weather(visibility_m=50.0), site())
    grey = disturb_cloud(cloud(base.xyz, np.full(20_000, 0.3)), Weather(visibility_m=50.0), site())
    assert bare.intensity is None
    assert bare.xyz.tobytes() == grey.xyz.tobytes()
    assert len(bare.xyz) < 20_000


@pytest.mark.parametrize("weather", [Weather(), Weather(lux=1.0), Weather(visibility_m=50_000.0)])
def test_what_a_lidar_does_not_feel_changes_nothing(weather):
    base = street()
    assert disturb_cloud(base, weather, site()) is base


@pytest.mark.parametrize("weather", [Weather(visibility_m=60.0), Weather(rain_mm_h=30.0), Weather(snow_mm_h=30.0),
                                     Weather(water_mm=1.0)])  # fmt: skip
def test_only_place_and_intensity_change_and_points_that_are_nowhere_stay(weather):
    base = street()
    xyz = base.xyz.copy()
    xyz[5], xyz[6] = np.nan, 0.0
    holed = cloud(xyz, base.intensity, ring=np.arange(20_000).astype(np.uint16), offset_ns=base.offset_ns)
    before = bytes_of(holed)
    after = disturb_cloud(holed, weather, site())
    assert bytes_of(holed) == before
    assert (np.diff(after.ring.astype(np.int64)) > 0).all()
    np.testing.assert_array_equal(after.offset_ns, base.offset_ns[after.ring])
    assert {5, 6} <= set(after.ring.tolist())
    assert np.isfinite(after.intensity).all()
    assert np.isnan(after.xyz).sum() == 3
    assert {name: a.dtype for name, a in fields_of(after).items()} == {n: a.dtype for n, a in fields_of(holed).items()}


def test_empty_clouds_stay_empty():
    empty = cloud(np.zeros((0, 3)), np.zeros(0))
    for weather in (Weather(visibility_m=50.0), Weather(rain_mm_h=9.0, water_mm=1.0)):
        assert len(disturb_cloud(empty, weather, site()).xyz) == 0


def test_weather_is_keyed_by_seed_and_stamp():
    base, weather = street(), Weather(rain_mm_h=30.0)
    later = cloud(base.xyz, base.intensity, stamp_ns=7)
    a, b, c, d = (bytes_of(disturb_cloud(m, weather, site(seed=s)))["xyz"] for m, s in
                  ((base, 0), (base, 0), (base, 1), (later, 0)))  # fmt: skip
    assert a == b
    assert len({a, c, d}) == 3


def test_wet_ground_is_darker_the_deeper_the_water_and_walls_are_not():
    base, medians, left = street(), [], []
    is_road = np.abs(base.xyz[:, 2] + 2) < 0.01
    for water_mm in (0.2, 0.4, 0.6, 0.9, 1.2):
        numbered = cloud(base.xyz, base.intensity, ring=np.arange(20_000).astype(np.uint16))
        after = disturb_cloud(numbered, Weather(water_mm=water_mm), site())
        road = is_road[after.ring]
        before = base.intensity[after.ring]
        lowest = (base.xyz[after.ring, 2] < -1.6) & ~road  # of walls: taken for road
        np.testing.assert_allclose(after.intensity[~road & ~lowest], before[~road & ~lowest], rtol=1e-6)
        np.testing.assert_array_equal(after.xyz, base.xyz[after.ring])
        medians.append(float(np.median(after.intensity[road] / before[road])))
        left.append(len(after.xyz))
    assert (np.diff(medians) < 0).all()
    assert (np.diff(left) <= 0).all()
    assert left[-1] < left[0] < 20_000
    assert medians[0] < 0.95


@pytest.mark.parametrize("rotation", [np.array([0.0, 0, 0, 1]), QUARTER_LEFT])
def test_covering_water_at_normal_incidence_halves_what_comes_back(rotation):
    """T = 1 - ((1.33 - 1) / 2.33)^2 = 0.980 both ways, into 1.33^2 = 1.769 of the solid angle: 0.543."""
    assert wet_share(1.2, np.array([1.0]))[0] == pytest.approx(0.980**2 / 1.33**2, rel=1e-3)
    assert wet_share(5.0, np.array([1.0])) == wet_share(1.2, np.array([1.0]))
    assert wet_share(0.6, np.array([1.0]))[0] == pytest.approx((1 + 0.543) / 2, rel=1e-3)
    assert (np.diff(wet_share(1.2, np.cos(np.radians(np.linspace(0, 89, 90))))) < 0).all()
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.5, 0.5, 40)))
    below = cloud(np.stack([x, y, np.full(1600, -2.0)], axis=1), np.full(1600, 0.4))
    after = disturb_cloud(below, Weather(water_mm=2.0), site(rotation=rotation))
    assert after.intensity.min() == pytest.approx(0.4 * 0.543, rel=0.01)


def test_ground_is_found_on_hills_and_not_among_too_few_points():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-40, 40, (2, 8000))
    z = -1.8 + 0.015 * x - 0.01 * y - 0.0005 * x * x + rng.normal(0, 0.02, 8000)
    car = np.stack([rng.uniform(8, 12, 900), rng.uniform(2, 4, 900), rng.uniform(1.4, 2.2, 900)], axis=1)
    ground = find_ground(np.concatenate([np.stack([x, y, z + 2], axis=1), car]), np.array([0, 0, 2.0]))
    assert (ground.rows < 8000).all()
    assert len(ground.rows) > 7900
    below = np.argmin(np.hypot(x, y)[ground.rows])
    assert ground.cos_incidence[below] == pytest.approx(1.0, abs=0.05)
    assert find_ground(np.zeros((10, 3)), np.array([0, 0, 2.0])) is None
    assert find_ground(rng.uniform(-30, 30, (60, 3)), np.zeros(3)) is None
