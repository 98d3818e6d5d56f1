"""Twins in PyTorch give what the kernels give, on the CPU and, where there is one, on a CUDA device."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")

from fbench.datasets.city.rig import thesis_rig  # noqa: E402
from fbench.pipelines.sensors.bev.grid import REACH_M, BevPoints, rasterize  # noqa: E402
from fbench.pipelines.sensors.points import ground  # noqa: E402
from fbench.pipelines.sensors.points.dbscan import dbscan  # noqa: E402
from fbench.pipelines.sensors.points.grid import lexicographic_order  # noqa: E402
from fbench.pipelines.sensors.points.ground import GroundParams  # noqa: E402
from fbench.pipelines.sensors.stereo import depth  # noqa: E402
from fbench.pipelines.sensors.stereo.depth import DepthParams, DisparityParams, Matcher, Rectifier  # noqa: E402
from fbench.pipelines.sensors.twins import bev, clustering, projection, stereo  # noqa: E402
from fbench.pipelines.sensors.twins import ground as ground_twin  # noqa: E402
from fbench.replay.contracts.errors import ConfigError, LogError  # noqa: E402
from fbench.replay.data.rig import CameraModel, Rig  # noqa: E402
from fbench.replay.geometry.camera import project_body  # noqa: E402
from fbench.replay.geometry.stereo_pairs import Pair  # noqa: E402

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


def pair_of_images(size_hw: tuple[int, int], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A slanted plane with stripes that stand out, seen twice with noise, and a patch without texture."""
    draw, (height, width) = np.random.default_rng(seed), size_hw
    scene = cv2.GaussianBlur(draw.integers(0, 256, (height, width + 60)).astype(np.uint8), (0, 0), 1.2)
    scene = cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX)
    v, u = np.indices(size_hw, np.float32)
    shift = 5 + 10 * v / height + 6 * (u // 25 % 2)
    left, right = (cv2.remap(scene, u + 30 + by, v, cv2.INTER_LINEAR) for by in (0 * u, shift))
    left[: height // 4, : width // 3] = 90
    return left, np.clip(right + draw.normal(0, 3, right.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("size_hw", "settings"),
    [
        ((40, 81), {}),
        ((37, 64), {"block_px": 3, "uniqueness": 0, "speckle_px": 0}),
        ((33, 50), {"block_px": 1, "smoothness": (1, 2), "left_right_px": 0, "uniqueness": 60}),
        ((48, 70), {"block_px": 7, "texture": 10.0, "speckle_px": 200, "left_right_px": 3}),
    ],
)
def test_disparities_are_equal(device, size_hw, settings):
    params = DisparityParams(**settings)
    matcher = Matcher(100.0, 0.6, size_hw[1], params)
    pairs = [pair_of_images(size_hw, seed) for seed in (0, 1)]
    left, right = (torch.from_numpy(np.stack(images)).to(device) for images in zip(*pairs, strict=True))
    twin = stereo.BatchMatcher(matcher.num_px, params)
    texture = twin.texture(left)
    found = [twin.disparity(left, right, texture).cpu().numpy() for _ in range(2)]
    for k, (one, other) in enumerate(pairs):
        wanted = matcher.texture(one)
        assert np.abs(texture[k].cpu().numpy() - wanted).max() < 1e-5
        wanted = matcher.disparity(one, other, wanted)
        assert 0.2 < np.isfinite(wanted).mean() < 0.95, "some pixels have a match, some have none"
        assert np.array_equal(found[0][k], wanted, equal_nan=True)
        assert np.array_equal(found[1][k], wanted, equal_nan=True), "a second time, too"


def test_what_would_overflow_in_opencv_is_refused():
    with pytest.raises(ConfigError, match="at most 10922, got 14175"):
        stereo.BatchMatcher(32, DisparityParams(block_px=9, smoothness=(8, 50)))
    image = torch.zeros(1, 12, 40, dtype=torch.uint8)
    with pytest.raises(ConfigError, match="a GPU needs images of more rows than 12"):
        stereo.BatchMatcher(32, DisparityParams()).disparity(image, image, image.float())


@pytest.mark.parametrize("device", DEVICES)
def test_points_of_depth_are_the_same(device):
    draw = np.random.default_rng(5)
    camera = CameraModel(np.array([[60.0, 0, 39.5], [0, 61.0, 19.5], [0, 0, 1]]), (80, 40))
    pose = np.array([[0.1, -0.02, 1, 1.5], [-1, 0.01, 0.1, 0.2], [0.02, -1, 0, 1.2], [0, 0, 0, 1.0]])
    how = Rectifier(Pair("left", "right", 0.5), camera, 0.5, pose, None)
    smooth = np.stack([cv2.GaussianBlur(draw.uniform(0, 20, (40, 80)), (0, 0), 4) - k for k in (4, 8)])
    disparity = np.round(smooth * 16).astype(np.float32) / 16
    disparity[draw.random(disparity.shape) < 0.2] = np.nan
    params = DepthParams(min_pixels=3)
    found = stereo.points(torch.from_numpy(disparity).to(device), how, 3.0, params)
    for one, wanted in zip(found, (depth.points(d, how, 3.0, params) for d in disparity), strict=True):
        assert len(wanted) > 20
        assert one.shape == wanted.shape
        assert np.abs(one.cpu().numpy() - wanted).max() < 1e-9
