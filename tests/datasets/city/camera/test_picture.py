"""What pixels show, against geometry worked out by hand."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fbench.datasets.city.instant import MISS, STATIC
from fbench.datasets.city.mesh import INDEX, Skin, box
from fbench.datasets.city.rig import RigSpec
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.images import decode
from fbench.replay.geometry.camera import project_boxes


def test_wall_has_its_exact_depth_everywhere(look, spec):
    wall = box((13, 0, 0), (2, 60, 60), Skin("plaster", (0.5, 0.5, 0.5)))
    shot = look([wall]).take(spec())
    assert np.allclose(shot.depth_m, 10.0, atol=1e-4)  # its face at x = 12, the camera at x = 2
    assert (shot.body == STATIC).all()
    assert (shot.material == INDEX["plaster"]).all()
    assert np.allclose(shot.normal, (-1, 0, 0), atol=1e-6)


def test_box_fills_the_pixels_that_it_projects_to(look, body, spec):
    shot = look([box((0, 0, -9), (1, 1, 1), Skin("soil", (0.1,) * 3))],
                [(body(size=(2.0, 2.0, 2.0)), (13.0, 0, 0), 0.0)]).take(spec())  # fmt: skip
    # the face at 10 m, y and z - 1 from -1 to 1: u, v = 199.5, 149.5 +- 200 * 1 / 10
    rows, columns = np.nonzero(shot.body == 1)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (180, 219, 130, 169)
    assert (shot.body == 1).sum() == 40 * 40
    assert np.allclose(shot.depth_m[140, 200], 10.0, atol=1e-4)
    assert shot.depth_m[10, 10] == np.inf
    assert shot.body[10, 10] == MISS
    assert shot.material[10, 10] == 255
    ((index, pixels),) = shot.alone
    assert index == 1
    assert np.array_equal(pixels, np.flatnonzero(shot.body.ravel() == 1))


def test_hidden_part_of_a_body_is_known(look, body, spec):
    screen = box((8, 1, 1), (0.2, 2, 4), Skin("concrete", (0.4,) * 3))  # hides all that is on the left
    shot = look([screen], [(body(size=(2.0, 2.0, 2.0)), (13.0, 0, 0), 0.0)]).take(spec())
    ((_, alone),) = shot.alone
    assert len(alone) == 1600
    assert (shot.body == 1).sum() == 800
    assert (shot.body.ravel()[alone] == 1).mean() == 0.5


@pytest.mark.parametrize(("size_wh", "fov_deg"), [((400, 300), 90.0), ((317, 211), 60.0), ((640, 120), 120.0)])
def test_projected_boxes_enclose_their_pixels(look, ground, body, spec, size_wh, fov_deg):
    places = [((9.0, 2.0, 0), 0.7), ((14.0, -3.0, 0), 2.0), ((30.0, 4.0, 0), -1.2), ((5.0, -4.0, 0), 0.0)]
    camera = spec(size_wh=size_wh, fov_deg=fov_deg)
    shot = look([ground], [(body(), place, yaw) for place, yaw in places]).take(camera)
    assert shot.rgb.shape == (size_wh[1], size_wh[0], 3)
    assert decode(shot.image).shape == shot.rgb.shape
    boxes = Boxes3D(np.array([(x, y, 0.75) for (x, y, _), _ in places]), np.tile((4.0, 1.8, 1.5), (4, 1)),
                    np.array([yaw for _, yaw in places]))  # fmt: skip
    rectangles, seen = project_boxes(RigSpec(cameras={"camera": camera}).rig(), "camera", boxes)
    for i in np.flatnonzero(seen):
        rows, columns = np.nonzero(shot.body == i + 1)
        left, top, right, bottom = rectangles[i]
        if len(rows):
            assert left - 0.01 <= columns.min() <= columns.max() <= right + 0.01
            assert top - 0.01 <= rows.min() <= rows.max() <= bottom + 0.01
    assert (shot.body > 0).sum() > 200


def test_camera_follows_the_ego_vehicle(look, body, spec):
    view = look([box((0, 0, -9), (1, 1, 1), Skin("soil", (0.1,) * 3))], [(body(), (100.0, 60.0, 0), 0.0)])
    position, yaw = view.states.position_m.copy(), view.states.yaw_rad.copy()
    position[0], yaw[0] = (100, 50, 0), np.pi / 2
    object.__setattr__(view.states, "position_m", position)
    object.__setattr__(view.states, "yaw_rad", yaw)
    shot = view.take(spec())
    assert shot.body[150, 200] == 1
    assert shot.depth_m[150, 200] == pytest.approx(60 - 0.9 - 50 - 2, abs=1e-4)


def test_only_sky(look, spec):
    shot = look([box((0, 0, -9), (1, 1, 1), Skin("soil", (0.1,) * 3))]).take(spec(yaw_pitch_roll_deg=(0.0, -60.0, 0.0)))
    assert (shot.body == MISS).all()
    assert np.isinf(shot.depth_m).all()
    assert shot.alone == ()
    assert 0.3 < shot.rgb.mean() / 255 < 0.8
    assert shot.rgb[..., 2].mean() > shot.rgb[..., 0].mean()  # blue


def test_same_bytes_and_noise_of_its_own(look, ground, spec):
    view, camera = look([ground]), spec(noise=0.01)
    one = view.take(camera)
    assert one.image.data == view.take(camera).image.data
    assert (one.image.sensor, one.image.stamp_ns, one.image.log_ns) == ("camera", 0, 5)
    for other in ({"sensor": "left"}, {"stamp_ns": 1}, {"seed": 2}):
        assert (view.take(camera, **other).rgb[200:] != one.rgb[200:]).mean() > 0.3


def test_same_bytes_from_threads(look, ground, body, spec):
    view, camera = look([ground], [(body(), (12.0, 2.0, 0), 0.3)]), spec(noise=0.01)
    alone = view.take(camera)
    with ThreadPoolExecutor(2) as pool:
        shots = list(pool.map(lambda _: view.take(camera), range(6)))
    assert all(shot.image.data == alone.image.data for shot in shots)
    assert all(np.array_equal(shot.depth_m, alone.depth_m) for shot in shots)


@pytest.mark.parametrize("size_wh", [(16, 16), (17, 33)])
@pytest.mark.parametrize("weather", [Weather(), Weather(lux=0.3, sun_elevation_deg=-30.0, rain_mm_h=20.0)])
def test_an_empty_world_is_sky_and_what_is_behind_the_camera_is_not_seen(look, ground, body, spec, size_wh, weather):
    camera = spec(size_wh=size_wh)
    empty = look([]).take(camera, weather, street_lamps_m=[(5.0, 0, 8)])
    assert (empty.body == MISS).all()
    assert decode(empty.image).shape == (size_wh[1], size_wh[0], 3)
    behind = look([ground], [(body(), (-10.0, 0, 0), 0.0)]).take(camera, weather)
    assert behind.alone == ()
    assert set(np.unique(behind.body)) == {MISS, STATIC}


def test_a_camera_inside_a_body_sees_it_from_inside(look, body, spec):
    shot = look([], [(body(), (2.0, 0, 0), 0.0)]).take(spec(), street_lamps_m=[(2.0, 0, 0.5)])
    assert (shot.body == 1).all()
    assert shot.depth_m[150, 200] == pytest.approx(2.0, abs=1e-4)
    assert ((shot.normal * shot.normal).sum(axis=2) > 0.99).all()
