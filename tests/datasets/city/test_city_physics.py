"""What a simulated log's measurements say of its world, checked from outside with plain numpy."""

import cv2
import numpy as np
import pytest
from tests.datasets.city.city_logs import body_velocity, in_boxes, moved, pixels, projected, simulated

from fbench.datasets.city.camera.develop import linear
from fbench.datasets.city.scenery.scenery import scenery
from fbench.datasets.city.world.urban import layout
from fbench.replay.data.metadata import inside

SIGMA_M = 0.01
SEEDS = {"urban": 3, "highway": 4}
FOG_PER_M, CLEAR_PER_M = np.log(20) / 100, np.log(20) / 20_000
"""Koschmieder: contrast falls to 5 % at the visibility of 100 m or 20 km."""


def labeled(log):
    """Clouds and scans with truth at their stamp: (stamp, message in body coordinates, boxes)."""
    for stamp_ns, cloud in log.clouds().items():
        if stamp_ns in log.truths:
            yield stamp_ns, moved(log.rig.body_T_sensor("lidar"), cloud.xyz), log.truths[stamp_ns].boxes3d


def scanned(log):
    for stamp_ns, scan in log.scans().items():
        if stamp_ns in log.truths:
            yield stamp_ns, scan, moved(log.rig.body_T_sensor("radar"), scan.xyz), log.truths[stamp_ns].boxes3d


def test_the_road_is_a_plane_and_ranges_have_the_stated_noise(log):
    roads = [region for region in log.info.regions if region.kind == "road"]
    errors = []
    for stamp_ns, cloud in log.clouds().items():
        range_m = np.linalg.norm(cloud.xyz.astype(float), axis=1)
        down = -cloud.xyz[:, 2] / range_m
        to_plane_m = 2.0 / np.where(down > 0.05, down, np.nan)  # the sensor is 2 m above z = 0
        where = moved(log.poses()[stamp_ns].world_T_body, moved(log.rig.body_T_sensor("lidar"), cloud.xyz))
        asphalt = cloud.intensity < 0.17 * down + 0.005  # markings, which lie on it, are brighter
        near = np.flatnonzero(asphalt & (np.abs(range_m - to_plane_m) < 0.06))
        errors.append((range_m - to_plane_m)[near][inside(roads, where[near, :2])])
    error = np.concatenate(errors)
    assert len(error) > 5000
    spread = np.percentile(error, [16, 50, 84])
    assert (spread[2] - spread[0]) / 2 == pytest.approx(SIGMA_M, rel=0.1)
    assert abs(spread[1]) < 0.002


def first_hits(origin, direction, corners):
    """Ranges (N,) to the first of T triangles (T, 3, 3) (Moeller and Trumbore 1997), infinite where none."""
    a, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    s = origin - a
    q = np.cross(s, e)
    found = []
    for d in direction:
        p = np.cross(d, f)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (e * p).sum(axis=1)
            u, v, t = (s * p).sum(axis=1) * scale, (q @ d) * scale, (f * q).sum(axis=1) * scale
            hit = (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6) & (t > 1e-6)
        found.append(t[hit].min(initial=np.inf))
    return np.array(found)


def test_points_of_what_stands_lie_on_the_first_surface(log):
    """Against the world's own triangles, intersected in numpy, for 250 beams to up to 40 m."""
    world = log.info.metadata["scenario"]
    static = scenery(layout(world, SEEDS[world]), SEEDS[world])
    stamp_ns, xyz, boxes = next(labeled(log))
    world_T_body = log.poses()[stamp_ns].world_T_body
    origin = moved(world_T_body, np.array([[0, 0, 2.0]]))[0]
    corners = static.vertices_m[static.triangles].astype(float)
    low, high = corners.min(axis=1)[:, :2] - origin[:2], corners.max(axis=1)[:, :2] - origin[:2]
    corners = corners[(low < 41).all(axis=1) & (high > -41).all(axis=1)]
    away = moved(world_T_body, xyz) - origin
    range_m = np.linalg.norm(away, axis=1)
    stands = np.flatnonzero(~in_boxes(xyz, boxes, 0.3).any(axis=0) & (range_m < 40))
    chosen = stands[np.random.default_rng(0).permutation(len(stands))[:250]]
    error = range_m[chosen] - first_hits(origin, away[chosen] / range_m[chosen, None], corners)
    beside = np.abs(error) > 5 * SIGMA_M  # beams that float32 lets pass an edge
    assert beside.mean() < 0.01
    assert error[~beside].std() == pytest.approx(SIGMA_M, rel=0.2)


def test_points_of_bodies_are_in_their_boxes(log):
    told, counted = 0, 0
    for _, xyz, boxes in labeled(log):
        within = in_boxes(xyz, boxes, 3 * SIGMA_M).sum(axis=1)
        assert (boxes.num_lidar_pts <= within).all()
        above = xyz[xyz[:, 2] > 0.25]  # without the ground that they stand on
        told += boxes.num_lidar_pts.sum()
        counted += in_boxes(above, boxes, 3 * SIGMA_M).sum()
    assert told > 200
    assert 0.8 * counted < told


@pytest.mark.slow
def test_points_of_moving_bodies_are_in_their_boxes_when_shot(tmp_path):
    """A raw cloud: each point where vehicle and body are at its own time."""
    args = ("--sensors", "lidar", "--set", "lidar.motion=true", "--set", "lidar.rate_hz=5", "--seconds", 1.2)
    log = simulated(tmp_path, "motion", "urban", "--seed", 3, *args)
    poses = log.poses()
    stamps = np.array(sorted(poses))
    path = np.array([poses[ns].translation_m for ns in stamps])
    turn = np.unwrap([2 * np.arctan2(poses[ns].rotation_xyzw[2], poses[ns].rotation_xyzw[3]) for ns in stamps])
    told, missed, checked = 0, 0, 0
    for stamp_ns, cloud in log.clouds().items():
        since_s = cloud.offset_ns / 1e9
        assert -0.2 < since_s.min() <= since_s.max() <= 0
        if stamp_ns - stamps[0] < 200_000_000:
            continue  # the log has no poses of so long ago
        boxes = log.truths[stamp_ns].boxes3d
        at = stamp_ns + cloud.offset_ns.astype(np.int64)
        middle = np.stack([np.interp(at, stamps, path[:, i]) for i in range(3)], axis=1)
        yaw = np.interp(at, stamps, turn)
        body = moved(log.rig.body_T_sensor("lidar"), cloud.xyz)
        cos, sin = np.cos(yaw), np.sin(yaw)
        world = np.stack([cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1], body[:, 2]], axis=1)
        world_T_body = poses[stamp_ns].world_T_body
        then = moved(np.linalg.inv(world_T_body), world + middle)
        for i in range(len(boxes)):
            shifted = then - boxes.velocity_mps[i] * since_s[:, None]
            within = in_boxes(shifted, boxes[i : i + 1], 0.15).sum()
            told += boxes.num_lidar_pts[i]
            missed += max(0, boxes.num_lidar_pts[i] - within)
            checked += boxes.attribute[i] == "moving" and boxes.num_lidar_pts[i] > 0
    assert checked > 5
    assert missed <= 0.005 * told  # bodies that turn


def test_radar_points_of_bodies_are_counted(log):
    told = 0
    for _, _, xyz, boxes in scanned(log):
        told += boxes.num_radar_pts.sum()
        for i, center in enumerate(boxes.center_m):  # noise and steps of 0.45 degrees, three times
            grown_m = 0.3 + 3 * np.radians(0.45) * np.linalg.norm(center)
            assert boxes.num_radar_pts[i] <= in_boxes(xyz, boxes[i : i + 1], grown_m).sum()
    assert told > 20


def over_ground(log, stamp_ns, scan, xyz):
    """Speeds of echoes with the ego vehicle's motion taken out, and directions, in body coordinates."""
    velocity, turn = body_velocity(log, stamp_ns)
    mount = log.rig.body_T_sensor("radar")[:3, 3]
    sensor = velocity + turn * np.array([-mount[1], mount[0], 0])
    away = (xyz - mount) / np.linalg.norm(xyz - mount, axis=1)[:, None]
    return scan.radial_velocity_mps + away @ sensor, away


def test_what_stands_has_no_speed_once_the_vehicles_is_taken_out(log):
    speed = []
    for stamp_ns, scan, xyz, boxes in scanned(log):
        ground, _ = over_ground(log, stamp_ns, scan, xyz)
        speed.append(ground[~in_boxes(xyz, boxes, 1.5).any(axis=0)])
    all_speeds = np.concatenate(speed)
    assert len(all_speeds) > 20_000
    assert np.abs(all_speeds).max() < 0.6  # noise of 0.05 m/s, steps of 0.1 m/s, and directions 0.3 degrees off
    assert abs(np.median(all_speeds)) < 0.01
    assert 0.04 < all_speeds.std() < 0.15


def test_radar_speeds_are_the_projected_velocities_of_bodies(log):
    errors = []
    for stamp_ns, scan, xyz, boxes in scanned(log):
        ground, away = over_ground(log, stamp_ns, scan, xyz)
        within = in_boxes(xyz, boxes, 0.1)
        for i in np.flatnonzero(boxes.attribute == "moving"):
            echoes = within[i] & (within.sum(axis=0) == 1) & (xyz[:, 2] > 0.3)
            errors += list(ground[echoes] - away[echoes] @ boxes.velocity_mps[i])
    if log.info.metadata["scenario"] == "highway":
        assert len(errors) > 10
    if errors:
        assert np.median(np.abs(errors)) < 0.1


def test_radar_points_are_those_of_the_polar_values(log):
    for scan in log.scans().values():
        r, a, e = (x.astype(float) for x in (scan.range_m, scan.azimuth_rad, scan.altitude_rad))
        xyz = np.stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)], axis=1)
        assert np.abs(xyz - scan.xyz).max() < 1e-4
        assert np.abs(r / 0.1 - np.round(r / 0.1)).max() < 1e-2  # steps of 0.1 m
        assert np.degrees(np.abs(a).max()) < 51.5
        assert np.degrees(np.abs(e).max()) < 26.5


def stereo_errors(log):
    """Of LiDAR points that the left camera shows, to 30 m ahead: |Z of the disparity / Z - 1|, NaN if none."""
    left, right = log.images("stereo_left"), log.images("stereo_right")
    K = log.rig.cameras["stereo_left"].K
    for stamp_ns, image in left.items():
        if stamp_ns not in log.clouds() or stamp_ns not in right:
            continue
        gray = [cv2.cvtColor(pixels(m), cv2.COLOR_BGR2GRAY) for m in (image, right[stamp_ns])]
        matcher = cv2.StereoSGBM.create(
            minDisparity=0, numDisparities=96, blockSize=7, P1=8 * 49, P2=32 * 49, disp12MaxDiff=1,
            uniquenessRatio=10, speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )  # fmt: skip
        disparity = matcher.compute(*gray) / 16.0
        uv, depth = projected(log, "stereo_left", moved(log.rig.body_T_sensor("lidar"), log.clouds()[stamp_ns].xyz))
        shown = np.flatnonzero(depth < 30)
        d = disparity[np.rint(uv[shown, 1]).astype(int), np.rint(uv[shown, 0]).astype(int)]
        yield np.where(d > 0, np.abs(K[0, 0] * 0.4 / np.maximum(d, 1e-3) / depth[shown] - 1), np.nan)


@pytest.mark.slow
@pytest.mark.parametrize(("world", "seed"), [("urban", 3), ("urban", 21), ("highway", 4)])
def test_depth_by_disparity_agrees_with_the_lidar(tmp_path, world, seed):
    """Z = f B / d with the thesis's cameras; the LiDAR, 2 m behind and 1 m above, sees some of what they don't."""
    cameras = ("--sensors", "stereo*", "--sensors", "lidar")
    log = simulated(tmp_path, "stereo", world, "--seed", seed, "--seconds", 0.4, *cameras)
    errors = np.concatenate(list(stereo_errors(log)))
    assert np.isfinite(errors).mean() > 0.5
    assert np.nanmedian(errors) < 0.02


def test_fog_takes_light_from_the_lidar_by_beer_lambert(under):
    clear, fog = (under(name).clouds() for name in ("clear", "fog"))
    ratios = []
    for stamp_ns, cloud in clear.items():
        other = fog[stamp_ns]
        shots = [c.ring.astype(np.int64) * 2**32 + c.offset_ns for c in (cloud, other)]
        _, a, b = np.intersect1d(*shots, return_indices=True)
        hard = np.abs(cloud.xyz[a] - other.xyz[b]).max(axis=1) < 1e-3
        hard &= cloud.intensity[a] < 1
        range_m = np.linalg.norm(cloud.xyz[a].astype(float), axis=1)
        ratios.append((range_m[hard], np.log(other.intensity[b] / cloud.intensity[a])[hard]))
        assert len(other.xyz) < 0.97 * len(cloud.xyz)
    range_m, loss = (np.concatenate(part) for part in zip(*ratios, strict=True))
    slope, offset = np.polyfit(range_m, loss, 1)
    assert slope == pytest.approx(-2 * (FOG_PER_M - CLEAR_PER_M), rel=0.01)
    assert abs(offset) < 0.01


def test_fog_takes_contrast_from_images_by_beer_lambert(under):
    """The same light and scene in air of 20 km and of 100 m: b = a t + A (1 - t), with the t that fits best."""
    haze, fog = under("fog", "--set", "weather.visibility_m=20000"), under("fog")
    stamp_ns = next(iter(haze.clouds()))
    body = moved(haze.rig.body_T_sensor("lidar"), haze.clouds()[stamp_ns].xyz)
    boxes = haze.truths[stamp_ns].boxes3d
    body = body[~in_boxes(body, boxes, 0.3).any(axis=0)]  # they have their lights on in fog
    uv, depth = projected(haze, "stereo_left", body)
    shown = np.flatnonzero((depth > 3) & (depth < 80) & (np.abs(uv - [239.5, 179.5]) < [225, 165]).all(axis=1))
    u, v = np.rint(uv[shown]).astype(int).T
    range_m = np.linalg.norm(body[shown] - [2.0, 0.2, 1.0], axis=1)
    a, b = (linear(pixels(x.images("stereo_left")[stamp_ns])[v, u, 1] / 255) for x in (haze, fog))
    dark = a < 0.7
    a, b, range_m = a[dark], b[dark], range_m[dark]

    def misfit(extinction):
        t = np.exp(-extinction * range_m)
        parts = np.stack([a * t, 1 - t], axis=1)
        weights = np.linalg.lstsq(parts, b, rcond=None)[0]
        return np.median(np.abs(b - parts @ weights))

    tried = (FOG_PER_M - CLEAR_PER_M) * np.linspace(0.5, 2, 151)
    best = tried[np.argmin([misfit(e) for e in tried])]
    assert best == pytest.approx(FOG_PER_M - CLEAR_PER_M, rel=0.15)


def test_the_radar_hardly_notices_fog(under):
    clear, fog = (sum(len(scan.xyz) for scan in under(name).scans().values()) for name in ("clear", "fog"))
    assert 0.99 * clear < fog <= clear


def test_lidar_and_radar_do_not_notice_night(under):
    day, night = under("clear"), under("night")
    for stamp_ns, cloud in day.clouds().items():
        other = night.clouds()[stamp_ns]
        assert cloud.xyz.tobytes() == other.xyz.tobytes()
        assert cloud.intensity.tobytes() == other.intensity.tobytes()
        assert cloud.log_ns == other.log_ns
    for stamp_ns, scan in day.scans().items():
        other = night.scans()[stamp_ns]
        assert scan.xyz.tobytes() == other.xyz.tobytes()
        assert scan.rcs_dbsm.tobytes() == other.rcs_dbsm.tobytes()
        assert scan.radial_velocity_mps.tobytes() == other.radial_velocity_mps.tobytes()
    light, dark = (pixels(next(iter(x.images("stereo_left").values()))).mean() for x in (day, night))
    assert dark < 0.8 * light


def test_rain_hides_surfaces_from_the_lidar_and_weakens_the_radar(under):
    clear, rain = under("clear"), under("heavy-rain")
    same, nearer, farther, before = 0, 0, 0, 0
    for stamp_ns, cloud in clear.clouds().items():
        other = rain.clouds()[stamp_ns]
        shots = [c.ring.astype(np.int64) * 2**32 + c.offset_ns for c in (cloud, other)]
        _, a, b = np.intersect1d(*shots, return_indices=True)
        change = np.linalg.norm(other.xyz[b], axis=1) - np.linalg.norm(cloud.xyz[a], axis=1)
        before += len(cloud.xyz)
        same += (np.abs(change) < 0.3).sum()
        nearer, farther = nearer + (change < -0.3).sum(), farther + (change > 0.3).sum()
    assert 0.8 * before < same < 0.99 * before
    assert nearer > 20 * farther  # drops are before what they hide
    num = [sum(len(s.xyz) for s in log.scans().values()) for log in (clear, rain)]
    assert 0.85 * num[0] < num[1] < num[0]
