"""Sign, ego motion and aliasing of radial velocities."""

import numpy as np
from tests.reports.preview.street import sample, street_rig

from fbench.replay.geometry.ego_velocity import wrap_velocity
from fbench.reports.preview.measure import check_doppler, doppler_panel


def scans(speed=12.0, sign=1, period=None, movers=0, ego=None, num=3):
    """Stationary points all around the front as a radar measures them that drives forward."""
    azimuth = np.radians(np.linspace(-60, 60, 121))
    xyz = np.stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), 0 * azimuth], axis=1)
    measured = -speed * np.cos(azimuth)
    measured[:movers] = np.linspace(-9, 9, movers) if movers else 0
    measured = sign * wrap_velocity(measured, period)
    return [sample(street_rig(), i, scans={"radar": (xyz, measured)}, ego=ego) for i in range(num)]


def directions(azimuth_deg):
    a = np.radians(azimuth_deg)
    return np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)


def test_driving_forward_is_right():
    found = check_doppler(scans(movers=20), "radar", None)
    assert not found.is_bad
    assert "drives forward at 12.0 m/s" in found.text


def test_a_wrong_sign_is_told():
    found = check_doppler(scans(sign=-1), "radar", None)
    assert found.is_bad
    assert "backwards at 12.0 m/s" in found.text
    assert "the sign is the other way round" in found.text


def test_poses_decide_about_the_sign():
    assert check_doppler(scans(ego=12.1), "radar", None).text.endswith("as its poses do")
    wrong = check_doppler(scans(speed=2.0, sign=-1, ego=2.0), "radar", None)
    assert wrong.is_bad
    assert "poses say forward at 2.0 m/s: the sign" in wrong.text
    other = check_doppler(scans(speed=12.0, ego=20.0), "radar", None)
    assert other.is_bad
    assert "but its poses say forward at 20.0" in other.text
    assert not check_doppler(scans(speed=-12.0, ego=-12.0), "radar", None).is_bad


def test_removed_ego_motion_is_told():
    assert "removed already" in check_doppler(scans(speed=0.0), "radar", None).text
    assert not check_doppler(scans(speed=0.0), "radar", None).is_bad
    assert check_doppler(scans(speed=0.0, ego=12.0), "radar", None).is_bad
    assert "its poses say" in check_doppler(scans(speed=0.0, ego=0.0), "radar", None).text
    assert not check_doppler(scans(speed=0.0), "radar", None, is_removed=True).is_bad
    assert check_doppler(scans(), "radar", None, is_removed=True).is_bad


def test_aliasing_is_undone_or_told():
    known = check_doppler(scans(speed=12.0, period=10.0), "radar", 10.0)
    assert not known.is_bad
    assert "forward at 12.0 m/s" in known.text
    unknown = check_doppler(scans(speed=16.0, period=10.0), "radar", None)
    assert unknown.is_bad
    assert "alias with a period of about 9.9" in unknown.text


def test_noise_is_explained_by_nothing():
    rng = np.random.Generator(np.random.Philox(1))
    noisy = [
        sample(street_rig(), scans={"radar": (directions(rng.uniform(-60, 60, 200)) * 20, rng.uniform(-30, 30, 200))})
    ]
    assert "no speed of the vehicle explains" in check_doppler(noisy, "radar", None).text


def test_without_velocities_there_is_no_panel():
    silent = [sample(street_rig(), scans={"radar": ([[10.0, 0, 0]], None)})]
    assert doppler_panel(silent, "radar", None) is None
    assert check_doppler(silent, "radar", None).text.startswith("no radial velocities: radar3d can't tell what moves")
    few = [sample(street_rig(), scans={"radar": ([[10.0, 0, 0]], [1.0])})]
    assert "too few" in check_doppler(few, "radar", None).text
    assert doppler_panel(scans(num=4), "radar", 10.0).shape == (540, 1278, 3)
