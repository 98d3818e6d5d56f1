"""Twins in PyTorch give what the kernels give, on the CPU and, where there is one, on a CUDA device."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")

from fbench.datasets.city.rig import thesis_rig  # noqa: E402
from fbench.pipelines.sensors.bev.grid import REACH_M, BevPoints, rasterize  # noqa: E402
from fbench.pipelines.sensors.points import ground  # noqa: E402
from fbench.pipelines.sensors.points.dbscan import dbscan  # noqa: E402
from fbench.pipelines.sensors.points.grid import lexicographic_order  # noqa: E402
from fbench.pipelines.sensors.points.ground import GroundParams  # noqa: E402
from fbench.pipelines.sensors.twins import bev, clustering, projection  # noqa: E402
from fbench.pipelines.sensors.twins import ground as ground_twin  # noqa: E402
from fbench.replay.contracts.errors import LogError  # noqa: E402
from fbench.replay.data.rig import CameraModel, Rig  # noqa: E402
from fbench.replay.geometry.camera import project_body  # noqa: E402

pytestmark = pytest.mark.torch
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here"))]


@pytest.mark.parametrize("device", DEVICES)
def test_points_are_drawn_alike(device):
    draw = np.random.default_rng(0)
    frames = [
        BevPoints(
            np.column_stack([draw.uniform(-60, 60, (num, 2)), draw.uniform(-1, 6, num)]).astype(np.float32),
            np.column_stack([draw.uniform(-60, 60, (num, 2)), draw.normal(0, 2, (num, 2))]).astype(np.float32),
        )
        for num in (4000, 0, 700)
    ]
    found = bev.rasterize_batch(frames, device).cpu().numpy()
    wanted = np.stack([rasterize(points) for points in frames])
    assert wanted[0, :-1].any(axis=(1, 2)).all(), "every channel shows something"
    assert np.abs(found - wanted).max() <= 1e-6
    assert (found[:, :9] == wanted[:, :9]).all(), "slices of height are equal"
    assert ((found > 0) == (wanted > 0)).all(), "and so is where anything is"


@pytest.mark.parametrize("device", DEVICES)
def test_points_on_the_borders_of_the_image_are_drawn_alike(device):
    edge = np.array([-REACH_M, REACH_M, np.nextafter(REACH_M, 0), -0.25, 0.0, 0.25])
    xy = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    points = BevPoints(np.column_stack([xy, np.full(len(xy), 0.5)]).astype(np.float32), np.zeros((0, 4), np.float32))
    assert (bev.rasterize_batch([points], device)[0].cpu().numpy()[:9] == rasterize(points)[:9]).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("adaptive", [False, True])
def test_clusters_are_equal(device, axes, adaptive):
    draw = np.random.default_rng(axes)
    blobs = draw.uniform(-20, 20, (25, axes))
    points = np.concatenate([(blobs[draw.integers(25, size=500)] + draw.normal(0, 0.4, (500, axes))),
                             draw.uniform(-25, 25, (150, axes)), np.tile(blobs[:1], (6, 1))])  # fmt: skip
    eps = 0.3 + 0.02 * np.abs(points[:, 0]) if adaptive else 0.5
    wanted = dbscan(points, eps, 5)
    found = clustering.dbscan(
        torch.from_numpy(points).to(device), torch.as_tensor(eps).to(device) if adaptive else 0.5, 5
    )
    assert wanted.max() > 5 or axes == 1
    assert (wanted < 0).any() or axes == 1
    assert (found.cpu().numpy() == wanted).all()


def test_a_grid_whose_distances_equal_the_radius_is_one_cluster():
    points = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), -1).reshape(-1, 2)
    found = clustering.dbscan(torch.from_numpy(points), 1.0, 4).numpy()
    assert (found == dbscan(points, 1.0, 4)).all()
    assert (found == 0).sum() == 144, "corners have three points within reach, and are border points"
    assert len(clustering.dbscan(torch.zeros(0, 2, dtype=torch.float64), 1.0, 4)) == 0


def hilly(num: int) -> np.ndarray:
    """Points on a tilted road with a ramp and walls beside it."""
    draw = np.random.default_rng(3)
    xy = draw.uniform(-70, 70, (num, 2))
    z = 0.02 * xy[:, 0] - 0.01 * xy[:, 1] + np.maximum(xy[:, 0] - 30, 0) * 0.03 + draw.normal(0, 0.02, num)
    z[::5] += draw.uniform(0, 4, len(z[::5]))
    z[::97] -= 1.5
    points = np.column_stack([xy, z])
    return points[lexicographic_order(*points.T)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("num", [2, 40, 6000])
def test_the_ground_is_the_same(device, num):
    points, params = hilly(num), GroundParams()
    plane, near, height = ground.find_ground(points, params)
    found, is_near, above = ground_twin.find_ground(torch.from_numpy(points).to(device), params)
    assert (plane is None) == (found is None) == (num == 2)
    assert (is_near.cpu().numpy() == near).all()
    assert np.abs(above.cpu().numpy() - height).max() < 1e-6


@pytest.mark.parametrize("device", DEVICES)
def test_points_are_projected_alike(device):
    rig = thesis_rig().rig()
    points = np.random.default_rng(4).uniform(-30, 30, (3000, 3))
    uv, depth = project_body(rig, "camera", points)
    found, far = (
        part.cpu().numpy() for part in projection.project_body(rig, "camera", torch.from_numpy(points).to(device))
    )
    assert np.allclose(far, depth, rtol=1e-9, atol=1e-9)
    assert np.allclose(found, uv, rtol=1e-9, atol=1e-9, equal_nan=True)
    assert np.isnan(uv).any()
    assert np.isfinite(uv).any()


def test_a_lens_that_distorts_is_refused():
    rig = thesis_rig().rig()
    bent = CameraModel(rig.cameras["camera"].K, (800, 600), "plumb_bob", np.array([0.1, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(LogError, match="camera 'camera': only cameras without distortion"):
        projection.project_body(Rig(rig.mounts, {"camera": bent}), "camera", torch.zeros(1, 3, dtype=torch.float64))
