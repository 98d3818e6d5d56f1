import numpy as np
from tests.pipelines.sensors.image.places import RIG, back

from fbench.pipelines.sensors.image.stage import Rays, share_beyond


def test_rays_that_go_on_behind():
    assert share_beyond(np.array([50.0, 50, 50, 50]), 18, 24) == 1.0
    assert share_beyond(np.array([20.0, 20, 20, 50]), 18, 24) == 0.25
    assert np.isnan(share_beyond(np.array([8.0, 8, 8]), 18, 24))  # something nearer hides the place
    assert np.isnan(share_beyond(np.zeros(0), 18, 24))


def test_depths_in_the_middle_of_a_box():
    rays = Rays.of(RIG, "cam", np.concatenate([back(20), back(40, 10.0)]))
    assert set(rays.depths(np.array([381.5, 285, 417.5, 319])).tolist()) == {20.0}
    assert len(Rays.of(RIG, "cam", None).depths(np.array([0.0, 0, 800, 600]))) == 0
