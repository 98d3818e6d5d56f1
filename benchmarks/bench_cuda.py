"""Time kernels, networks and late3d's frame on the CPU against PyTorch on a CUDA device.

python benchmarks/bench_cuda.py: medians over frames of a drive that it simulates, beside the thesis's figures on an RTX
4090. Transfers to and from the device count where a row says so. Without a GPU, PyTorch's CPU stands in for it.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import onnxruntime
import torch
from common import frames_of, write_drive
from torch import Tensor
from torch.nn import functional

from fbench.datasets.city.rig import thesis_rig
from fbench.pipelines.models.bev_network import BevNetwork
from fbench.pipelines.models.network import CityDetector
from fbench.pipelines.sensors.bev import detector as bev_detector
from fbench.pipelines.sensors.bev.detector import BevParams, open_detector
from fbench.pipelines.sensors.bev.grid import BevPoints, lidar_rows, rasterize
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS, CameraDetector, CameraParams
from fbench.pipelines.sensors.lidar.clusters import LidarParams, clusters, obstacles
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.points import ground
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.stereo import depth
from fbench.pipelines.sensors.stereo.depth import DepthParams, DisparityParams, Matcher, Rectifier
from fbench.pipelines.sensors.twins import bev, clustering, projection, stereo
from fbench.pipelines.sensors.twins import ground as ground_twin
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Float64
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import Pixels, decode, decode_grey
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import project_body

SEED, NUM_FRAMES, BATCHES = 202, 8, (1, 4, 8)
ON_GPU = torch.cuda.is_available()
DEVICE, ROUNDS = ("cuda", 5) if ON_GPU else ("cpu", 1)
LIDAR, RADAR = LidarParams(), RadarParams()
INPUT_HW, LEAST_SCORE = (480, 640), 0.3


@dataclass(frozen=True, eq=False)
class Inputs:
    """What one frame holds, decoded."""

    image: Pixels  # (H, W, 3) BGR
    cloud: Float64  # (N, 3) [m] in body coordinates, in lexicographic order
    echoes: Float64  # (N, 3) x, y and radial velocity of moving echoes
    drawn: BevPoints
    left: Pixels  # (H, W) grey, rectified and shrunk, as is `right`
    right: Pixels


def read(rig: Rig, info: LogInfo, frames: Sequence[Frame], how: Rectifier) -> list[Inputs]:
    """Decode the frames that have all sensors."""
    settings = SensorSettings(Late3DParams(), rig)
    of_lidar, of_radar = LidarStage(rig, info, LIDAR, settings), RadarStage(rig, info, RADAR, settings)
    found = []
    for frame in frames:
        cloud, seen = of_lidar.points(frame, StageClock()), of_radar.echoes(frame, StageClock())
        messages = [frame.messages.get(name) for name in ("camera", how.pair.left, how.pair.right)]
        images = [one for one in messages if isinstance(one, Image)]
        if cloud is None or seen is None or len(images) < len(messages):
            continue
        image, *pair = images
        pixels, left, right = decode(image), *(decode_grey(one) for one in pair)
        if pixels is None or left is None or right is None:
            continue
        moving = np.abs(seen.range_rate_mps) >= RADAR.min_speed_mps
        echoes = np.column_stack([seen.xyz[moving, :2], seen.range_rate_mps[moving]])
        rows = np.column_stack([seen.xyz, np.nan_to_num(seen.range_rate_mps)]).astype(np.float32)
        drawn = BevPoints(lidar_rows(cloud, ground.find_ground(cloud, LIDAR.ground)[2]), rows)
        found.append(Inputs(pixels, cloud, echoes, drawn, *how.images(left, right)))
    return found[: NUM_FRAMES if ON_GPU else 2]


def median_ms(work: Callable[[Any], object], inputs: Sequence[Any]) -> float:
    """Median time of one call; the device is waited for before and after."""
    times = []
    for turn in range(ROUNDS + 1):
        for one in inputs:
            if ON_GPU:
                torch.cuda.synchronize()
            begin = perf_counter()
            work(one)
            if ON_GPU:
                torch.cuda.synchronize()
            if turn:  # the first warms up
                times.append(perf_counter() - begin)
    return float(np.median(times)) * 1e3


def row(name: str, cells: Sequence[float | None], thesis: str = "") -> None:
    """Print one line of the table: kernel or onnxruntime on the CPU, onnxruntime on CUDA, PyTorch on the device."""
    print(
        f"{name:46}" + "".join(f"{'':>12}" if ms is None else f"{ms:12.2f}" for ms in cells) + f"  {thesis}", flush=True
    )


def upload(array: Any) -> Tensor:
    """Copy an array to the device."""
    return torch.from_numpy(np.ascontiguousarray(array)).to(DEVICE)


class DeviceFrame:
    """Steps of late3d that have a twin or a network, on the device."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self.camera, self.birds_eye = rig, CityDetector(7).eval().to(DEVICE), BevNetwork().eval().to(DEVICE)

    def look(self, images: Sequence[Pixels]) -> list[Tensor]:
        """Boxes and scores that the camera network finds in images of one size, from transfer to transfer."""
        given = upload(np.stack(images)).flip(3).permute(0, 3, 1, 2).float() / 255
        logits, boxes = self.camera(functional.interpolate(given, INPUT_HW, mode="bilinear", antialias=True))
        score = logits.sigmoid().amax(1)
        kept = score > LEAST_SCORE
        return [boxes.transpose(1, 2)[kept].cpu(), score[kept].cpu()]

    def look_from_above(self, points: Sequence[BevPoints]) -> Tensor:
        """Output of the bird's-eye network, drawing and transfers included."""
        found: Tensor = self.birds_eye(bev.rasterize_batch(points, DEVICE))
        return found.cpu()

    def clusters(self, xyz: Tensor) -> Tensor:
        """Cluster obstacles as `lidar.clusters.clusters`."""
        grown = (torch.hypot(xyz[:, 0], xyz[:, 1]) / (LIDAR.cluster.adaptive_from_m or torch.inf)).clamp(min=1)
        return clustering.dbscan(xyz[:, :2], LIDAR.cluster.eps_m * grown, LIDAR.cluster.min_points)

    def step(self, one: Inputs) -> list[Tensor]:
        """One frame, transfers included."""
        seen, cloud = self.look([one.image]), upload(one.cloud)
        _, near, height = ground_twin.find_ground(cloud, LIDAR.ground)
        standing = near & (height > LIDAR.ground.tolerance_m) & (height < LIDAR.cluster.max_height_m)
        found = cloud[standing]
        pixels, far = projection.project_body(self._rig, "camera", cloud)
        moving = clustering.dbscan(upload(one.echoes), RADAR.cluster.eps_m, RADAR.cluster.min_points)
        return [*seen, *(part.cpu() for part in (found, height[standing], self.clusters(found), pixels, far, moving))]


class CpuFrame:
    """The same steps by the kernels and onnxruntime."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._camera = rig, CameraDetector(CameraParams(weights=CITY_WEIGHTS, threads=2))

    def look(self, image: Pixels) -> object:
        """Boxes in one image."""
        return self._camera.infer(self._camera.prepare(image))

    def step(self, one: Inputs) -> object:
        """One frame."""
        found = obstacles(one.cloud, LIDAR)
        pixels = project_body(self._rig, "camera", one.cloud)
        moving = dbscan(one.echoes, RADAR.cluster.eps_m, RADAR.cluster.min_points)
        return self.look(one.image), clusters(found.xyz, LIDAR.cluster), pixels, moving


def ort_on_cuda(path: Path) -> Callable[[Any], object] | None:
    """Run a network by onnxruntime's CUDA provider, where there is one."""
    if "CUDAExecutionProvider" not in onnxruntime.get_available_providers():
        return None
    onnxruntime.preload_dlls()  # finds the libraries that torch brings
    session = onnxruntime.InferenceSession(str(path), providers=["CUDAExecutionProvider", "CPUExecutionProvider"])
    if session.get_providers()[0] != "CUDAExecutionProvider":
        return None
    name = session.get_inputs()[0].name
    return lambda given: session.run(None, {name: given})


def time_kernels(frames: Sequence[Inputs], rig: Rig, on_device: DeviceFrame) -> None:
    """Kernels against their twins, without transfers but for drawing."""
    clouds, found = [one.cloud for one in frames], [obstacles(one.cloud, LIDAR).xyz for one in frames]
    echoes, drawn = [one.echoes for one in frames], [one.drawn for one in frames]

    def compare(name: str, kernel: Callable[[Any], object], given: list[Any], twin: Callable[[Any], object],
                thesis: str = "") -> None:  # fmt: skip
        row(name, [median_ms(kernel, given), None, median_ms(twin, [upload(one) for one in given])], thesis)

    compare(
        "projection", partial(project_body, rig, "camera"), clouds,
        partial(projection.project_body, rig, "camera"), "0.13 (calibration)",
    )  # fmt: skip
    compare("ground", lambda x: ground.find_ground(x, LIDAR.ground), clouds,
            lambda x: ground_twin.find_ground(x, LIDAR.ground))  # fmt: skip
    compare("DBSCAN of obstacles", lambda x: clusters(x, LIDAR.cluster), found, on_device.clusters, "13 to 25")
    compare("DBSCAN of moving echoes", lambda x: dbscan(x, 2.0, 5), echoes, lambda x: clustering.dbscan(x, 2.0, 5))
    compare("DBSCAN of all points, 0.5 m", lambda x: dbscan(x, 0.5, 5), clouds, lambda x: clustering.dbscan(x, 0.5, 5))
    on_gpu = median_ms(lambda one: bev.rasterize_batch([one], DEVICE), drawn)
    row("drawing of points, with transfer", [median_ms(rasterize, drawn), None, on_gpu])


def time_stereo(frames: Sequence[Inputs], how: Rectifier) -> None:
    """Stereo of one and more pairs, with transfer of the images."""
    params = DisparityParams()
    camera = how.camera
    matcher = Matcher(float(camera.K[0, 0]), how.baseline_m, camera.size_wh[0], params)
    twin = stereo.BatchMatcher(matcher.num_px, params)

    def match(one: Inputs) -> Any:
        return matcher.disparity(one.left, one.right, matcher.texture(one.left))

    def match_batch(some: Sequence[Inputs]) -> Tensor:
        left, right = upload(np.stack([one.left for one in some])), upload(np.stack([one.right for one in some]))
        return twin.disparity(left, right, twin.texture(left))

    wanted = np.stack([match(one) for one in frames[:2]])
    found = match_batch(frames[:2]).cpu().numpy()
    assert ((found == wanted) | (np.isnan(found) & np.isnan(wanted))).all(), "disparities are equal"
    on_cpu = median_ms(match, frames)
    for num in BATCHES if ON_GPU else (1,):
        some = [list(np.resize(np.array(frames), num))]
        ms = median_ms(match_batch, some) / num
        row(f"disparity, {num} pairs, each, with transfer", [on_cpu, None, ms], "16.33 (with rectification)")
    given = [wanted[:1], wanted[1:]]
    row(
        "points of disparities",
        [median_ms(lambda d: depth.points(d[0], how, 3.0, DepthParams()), given), None,
         median_ms(lambda d: stereo.points(d, how, 3.0, DepthParams()), [upload(one) for one in given])],
    )  # fmt: skip


def time_networks(frames: Sequence[Inputs], on_cpu: CpuFrame, on_device: DeviceFrame) -> None:
    """Networks on batches of sensors, from decoded image or points to output, with transfers."""
    detector = open_detector(BevParams(threads=2))
    camera_ms = median_ms(lambda one: on_cpu.look(one.image), frames)
    above_ms = median_ms(lambda one: detector.detect(one.drawn, Plane(0, 0, 0), 0.4), frames)
    eye, above = ort_on_cuda(CITY_WEIGHTS), ort_on_cuda(bev_detector.BUILTIN)
    for num in BATCHES:
        some = list(np.resize(np.array(frames), num))
        blank = np.random.default_rng(0).random((num, 3, *INPUT_HW), np.float32)
        images, points = [one.image for one in some], [one.drawn for one in some]
        on_cuda = None if eye is None else median_ms(eye, [blank]) / num
        row(f"camera network, {num} images, each", [camera_ms, on_cuda, median_ms(on_device.look, [images]) / num],
            "7.32 (YOLOv8)")  # fmt: skip
        on_cuda = None if above is None or num > 1 else median_ms(lambda x: above(rasterize(x)[None]), points)
        row(f"bird's-eye network, {num} clouds, each",
            [above_ms, on_cuda, median_ms(on_device.look_from_above, [points]) / num])  # fmt: skip


def main() -> None:
    torch.set_num_threads(2 if ON_GPU else 1)
    with tempfile.TemporaryDirectory() as folder:
        path = write_drive(
            Path(folder, "drive.mcap"), "urban", NUM_FRAMES / 20 + 0.15 if ON_GPU else 0.2, SEED, thesis_rig().names
        )
        rig, info, frames = frames_of(path)
    pair = depth.choose_pair(rig, info.name, None, None)
    how = depth.rectifier(rig, pair, DisparityParams().shrink)
    given = read(rig, info, frames, how)
    on_cpu, on_device = CpuFrame(rig), DeviceFrame(rig)
    print(
        f"{len(given)} frames: {np.mean([len(one.cloud) for one in given]):.0f} points, "
        f"{np.mean([len(one.echoes) for one in given]):.0f} moving echoes, image {given[0].image.shape[1::-1]}, stereo "
        f"{given[0].left.shape[::-1]}; torch {torch.__version__}, onnxruntime {onnxruntime.__version__}, numpy "
        f"{np.__version__}, {torch.cuda.get_device_name() if ON_GPU else 'no GPU'}"
    )
    print(f"{'medians in ms':46}{'CPU':>12}{'ORT CUDA':>12}{'torch ' + DEVICE:>12}  the thesis, RTX 4090")
    with torch.no_grad():
        time_kernels(given, rig, on_device)
        time_networks(given, on_cpu, on_device)
        row("late3d: networks and twins, with transfers",
            [median_ms(on_cpu.step, given), None, median_ms(on_device.step, given)], "91.40 (with fusion)")  # fmt: skip
    late3d = Late3D()
    late3d.start(rig, info)
    times = []
    for turn in range(2):  # the first warms up
        late3d.reset("again")
        for frame in frames:
            begun = perf_counter()
            late3d.step(frame)
            if turn:
                times.append(perf_counter() - begun)
    row("late3d: whole frame, decoding and tracking too", [float(np.median(times)) * 1e3, None, None],
        "114.72 (without display)")  # fmt: skip
    with torch.no_grad():
        time_stereo(given, how)


main()
