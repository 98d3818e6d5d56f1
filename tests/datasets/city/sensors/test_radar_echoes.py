"""How strong a radar's echoes are, in every weather, and which are false."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from tests.datasets.city.sensors.radar_worlds import (
    EXACT,
    car,
    ground,
    hall,
    look,
    pedestrian,
    radar,
    states,
    truck,
    world,
)

from fbench.datasets.city.instant import MISS
from fbench.datasets.city.mesh import Skin, box, merge_meshes
from fbench.replay.conditions.weather import Weather, radar_loss_db

ASPECTS = np.radians([0, 15, 30, 45, 60, 75, 90, 120, 150, 180])
FOG = Weather(visibility_m=50.0)


def total_dbsm(body, yaw, distance_m):
    """The cross-section of a whole body: the sum of all echoes on it, over some scans."""
    caster, spec = world(ground(), body), radar(**EXACT)
    scans = [look(caster, states((0, 0, 0), (2 + distance_m, 0, yaw)), spec, seed=seed) for seed in range(4)]
    return 10 * np.log10(np.mean([_power(found, found.body == 1) for found in scans]))


def _power(found, rows):
    return (10 ** (found.message.rcs_dbsm[rows].astype(np.float64) / 10)).sum()


@pytest.mark.parametrize(
    ("body", "low", "high", "mean"),
    [(car(), 5, 20, 10), (pedestrian(), -10, 0, -5), (truck(), 15, 25, 20)],
    ids=["car", "pedestrian", "truck"],
)
def test_bodies_have_the_cross_sections_known_of_them(body, low, high, mean):
    totals = np.array([total_dbsm(body, yaw, 20.0) for yaw in ASPECTS])
    assert ((totals > low) & (totals < high)).all()
    assert totals.mean() == pytest.approx(mean, abs=2.5)


def test_cross_section_of_a_body_does_not_depend_on_distance_or_rays():
    near, far = total_dbsm(truck(), 0.4, 15.0), total_dbsm(truck(), 0.4, 30.0)
    assert near == pytest.approx(far, abs=0.7)
    caster, at = world(ground(), truck()), states((0, 0, 0), (22, 0, 0.4))
    few, many = (look(caster, at, radar(**EXACT, points_per_s=points)) for points in (250_000, 1_000_000))
    assert (many.body == 1).sum() == pytest.approx(4 * (few.body == 1).sum(), rel=0.05)
    ratio = _power(many, many.body == 1) / _power(few, few.body == 1)
    assert 10 * np.log10(ratio) == pytest.approx(0, abs=0.5)


def test_a_plate_seen_squarely_has_the_cross_section_of_its_material():
    """4 m2 of concrete at -8 dB a square meter: -2 dBsm."""
    plate = box((30, 0, 1), (0.2, 2, 2), Skin("concrete", (0.5, 0.5, 0.5)))
    level = np.eye(4)
    level[:3, 3] = [0, 0, 1]
    scans = [look(world(plate), states((0, 0, 0)), radar(**EXACT), seed=seed, mount=level) for seed in range(20)]
    total = np.mean([_power(found, found.body == -1) for found in scans])
    assert 10 * np.log10(total) == pytest.approx(-2, abs=0.2)


def test_cars_are_seen_with_many_echoes_far_away():
    caster = world(ground(), car())
    num = {}
    for distance_m in (20, 40, 80, 95):
        scans = [look(caster, states((0, 0, 0), (distance_m + 2, 0, 0.8)), seed=seed) for seed in range(8)]
        num[distance_m] = np.mean([(found.body == 1).sum() for found in scans])
    assert num[20] > 60
    assert num[40] > 15
    assert num[80] > 3
    assert num[95] > 1.5


def test_pedestrians_are_lost_farther_than_cars_are():
    caster = world(ground(), pedestrian())
    near, far = (
        np.mean([(look(caster, states((0, 0, 0), (x, 0, 0)), seed=seed).body == 1).sum() for seed in range(10)])
        for x in (30, 95)
    )
    assert near > 3
    assert far < 1


def test_walls_and_poles_are_seen_far_away_and_asphalt_only_near():
    wall = box((82, 0, 5), (1, 60, 10), Skin("brick", (0.5, 0.5, 0.5)))
    poles = [box((50, y, 4), (0.3, 0.3, 8), Skin("pole", (0.5, 0.5, 0.5))) for y in (-10, 0, 10)]
    far = look(world(merge_meshes([ground(), wall])), states((0, 0, 0)))
    assert (far.true_range_m > 75).sum() > 150
    assert (look(world(merge_meshes([ground(), *poles])), states((0, 0, 0))).true_range_m > 40).sum() > 10
    asphalt = look(world(ground()), states((0, 0, 0)))
    assert np.quantile(asphalt.true_range_m, 0.99) < 15
    assert asphalt.true_range_m.max() < 20
    assert asphalt.message.rcs_dbsm.max() < -20


def test_radar_hardly_notices_fog():
    wall = box((60, 0, 5), (1, 200, 10), Skin("brick", (0.5, 0.5, 0.5)))
    caster, at = world(merge_meshes([ground(), wall]), car(), truck()), states((0, 0, 0), (20, 3, 0.3), (45, -6, 1.0))
    clear, fog = look(caster, at), look(caster, at, weather=FOG)
    assert len(fog.body) > 0.99 * len(clear.body)
    for i in (1, 2):
        assert (fog.body == i).sum() > 0.99 * (clear.body == i).sum()


def test_rain_takes_from_each_echo_what_the_equation_says():
    caster, at, rain = world(hall(60)), states((0, 0, 0)), Weather(rain_mm_h=50.0)
    clear, wet = look(caster, at), look(caster, at, weather=rain)
    assert len(clear.body) == len(wet.body) == 12_500  # metal all around: nothing is lost
    lost = clear.message.rcs_dbsm - wet.message.rcs_dbsm
    expected = radar_loss_db(rain, clear.true_range_m) - radar_loss_db(Weather(), clear.true_range_m)
    np.testing.assert_allclose(lost, expected, atol=1e-5)
    np.testing.assert_array_equal(clear.message.xyz, wet.message.xyz)


def test_more_rain_loses_more_echoes_and_moves_none():
    wall = box((80, 0, 5), (1, 200, 10), Skin("brick", (0.5, 0.5, 0.5)))
    caster, at = world(merge_meshes([ground(), wall])), states((0, 0, 0))
    scans = [look(caster, at, weather=Weather(rain_mm_h=rate)) for rate in (0.0, 5.0, 25.0, 100.0)]
    num = [len(found.body) for found in scans]
    assert num == sorted(num, reverse=True)
    assert num[-1] < 0.9 * num[0]
    dry = {tuple(xyz) for xyz in scans[0].message.xyz.tolist()}
    assert all(tuple(xyz) in dry for found in scans[1:] for xyz in found.message.xyz.tolist())


def test_clutter_is_what_it_is_said_to_be():
    caster, at = world(ground()), states((0, 0, 0, 20.0))
    scans = [look(caster, at, radar(clutter=200.0), seed=seed) for seed in range(20)]
    false = [found.body == MISS for found in scans]
    num = np.array([rows.sum() for rows in false])
    assert num.mean() == pytest.approx(200, abs=3 * np.sqrt(200 / 20))
    assert num.std() > 5
    rcs, range_m, speed = (
        np.concatenate([getattr(found.message, name)[rows] for found, rows in zip(scans, false, strict=True)])
        for name in ("rcs_dbsm", "range_m", "radial_velocity_mps")
    )
    assert rcs.mean() == pytest.approx(-10, abs=0.3)
    assert rcs.std() == pytest.approx(5, rel=0.05)
    shares = np.histogram(range_m, bins=[0.9, 3.1623, 10, 31.623, 101])[0] / len(range_m)
    np.testing.assert_allclose(shares, 0.25, atol=0.03)  # as many in each equal step of the logarithm: 1 / r
    ahead = np.concatenate(
        [found.message.xyz[rows] / found.message.range_m[rows, None] for found, rows in zip(scans, false, strict=True)]
    )
    pitch = np.radians(5)
    over_ground = speed + 20 * (np.cos(pitch) * ahead[:, 0] - np.sin(pitch) * ahead[:, 2])
    assert over_ground.mean() == pytest.approx(0, abs=0.05)
    assert over_ground.std() == pytest.approx(0.5, rel=0.05)
    assert all(np.isnan(found.true_range_m[rows]).all() for found, rows in zip(scans, false, strict=True))


def test_real_echoes_are_the_same_with_and_without_false_ones():
    caster, at = world(ground(), car()), states((0, 0, 0), (15, 0, 0))
    clean, dirty = look(caster, at), look(caster, at, radar(clutter=20.0, multipath=0.5))
    real = dirty.body != MISS
    assert not real.all()
    np.testing.assert_array_equal(dirty.message.xyz[real], clean.message.xyz)


def test_ghosts_come_later_and_weaker_from_the_same_direction():
    caster, at = world(ground(), car()), states((0, 0, 0), (15, 0, 0, 6.0))
    found = look(caster, at, radar(**EXACT, multipath=1.0))
    ghost, real = found.body == MISS, found.body == 1
    assert 20 < ghost.sum() <= real.sum()
    message = found.message
    twin = [np.flatnonzero(real & (message.azimuth_rad == a))[0] for a in message.azimuth_rad[ghost]]
    later = message.range_m[ghost] - message.range_m[twin]
    assert ((later >= 1) & (later <= 10)).all()
    assert np.ptp(later) > 6
    np.testing.assert_array_equal(message.altitude_rad[ghost], message.altitude_rad[twin])
    np.testing.assert_allclose(message.rcs_dbsm[ghost], message.rcs_dbsm[twin] - 10, atol=1e-5)
    times = message.radial_velocity_mps[ghost] / message.radial_velocity_mps[twin]
    assert set(np.round(times, 4)) == {1.0, 2.0}
    assert np.isnan(found.true_range_m[ghost]).all()


def test_only_strong_echoes_of_road_users_have_ghosts_and_as_often_as_said():
    assert not (look(world(hall(40)), states((0, 0, 0)), radar(multipath=1.0)).body == MISS).any()
    caster, at = world(ground(), car()), states((0, 0, 0), (15, 0, 0.5))
    always, sometimes = (
        np.mean([(look(caster, at, radar(multipath=share), seed=seed).body == MISS).sum() for seed in range(20)])
        for share in (1.0, 0.3)
    )
    assert sometimes / always == pytest.approx(0.3, abs=0.05)


def _bytes(found):
    arrays = [found.body, found.true_range_m, *(a for a in vars(found.message).values() if isinstance(a, np.ndarray))]
    return b"".join(a.tobytes() for a in arrays)


def test_same_seed_same_bytes_in_any_thread_and_order():
    caster, spec = world(ground(), car()), radar(clutter=10.0, multipath=0.3, merge_cells=True)
    at = [states((0, 0, 0, 10.0), (15 + i, 0, 0.2 * i, 3.0)) for i in range(16)]
    serial = [_bytes(look(caster, one, spec, stamp_ns=i)) for i, one in enumerate(at)]
    with ThreadPoolExecutor(4) as pool:
        threaded = list(pool.map(lambda i: _bytes(look(caster, at[i], spec, stamp_ns=i)), reversed(range(16))))
    assert threaded[::-1] == serial


def test_other_seed_stamp_or_sensor_other_noise():
    caster, at = world(ground(), car()), states((0, 0, 0), (15, 0, 0))
    kinds = [_bytes(look(caster, at, seed=seed, stamp_ns=stamp)) for seed, stamp in ((1, 0), (2, 0), (1, 1))]
    assert len(set(kinds)) == 3
    assert look(caster, at).message.stamp_ns == 0
    assert look(caster, at).message.log_ns == 5
