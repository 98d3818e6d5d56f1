"""Time kernels on the CPU against their twins in PyTorch, on the CPU and on a CUDA device.

python benchmarks/bench_cuda.py LOG.mcap: medians over the frames of a log with LiDAR and radar, transfers left out.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fbench.api.logs import open_log
from fbench.datasets.city.rig import thesis_rig
from fbench.pipelines.models.bev_network import BevNetwork
from fbench.pipelines.models.network import CityDetector
from fbench.pipelines.sensors.bev.detector import BUILTIN, BevParams, open_detector
from fbench.pipelines.sensors.bev.grid import NUM_CHANNELS, SIDE, BevPoints, lidar_rows, rasterize
from fbench.pipelines.sensors.lidar.stage import LidarParams, LidarStage, obstacles
from fbench.pipelines.sensors.points import ground
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.twins import bev, clustering, projection
from fbench.pipelines.sensors.twins import ground as ground_twin
from fbench.pipelines.variants.learned3d import Learned3DParams
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.geometry.camera import project_body

NUM_FRAMES, ROUNDS = 10, 5


def median_ms(work: Callable[[Any], object], inputs: list[Any], device: str) -> float:
    """Median time of one call; a device is waited for before and after."""
    times = []
    for turn in range(ROUNDS + 1):
        for one in inputs:
            if device == "cuda":
                torch.cuda.synchronize()
            begin = time.perf_counter()
            work(one)
            if device == "cuda":
                torch.cuda.synchronize()
            if turn:  # the first warms up
                times.append(time.perf_counter() - begin)
    return float(np.median(times)) * 1e3


def draw(device: str, one: BevPoints) -> object:
    """Draw one frame, transfer included."""
    return bev.rasterize_batch([one], device)


def main(path: Path) -> None:
    torch.set_num_threads(2)
    log = open_log(path)
    settings = SensorSettings(Learned3DParams(), log.rig)
    lidar, radar = LidarParams(), RadarParams()
    of_lidar = LidarStage(log.rig, log.info, lidar, settings)
    of_radar = RadarStage(log.rig, log.info, radar, settings)
    clouds, clusters, echoes, drawn = [], [], [], []
    for frame in log.frames():
        xyz, seen = of_lidar.points(frame, StageClock()), of_radar.echoes(frame, StageClock())
        if xyz is None or seen is None:
            continue
        _, _, height = ground.find_ground(xyz, lidar.ground)
        clouds.append(xyz)
        clusters.append(np.ascontiguousarray(obstacles(xyz, lidar).xyz[:, :2]))
        moving = np.abs(seen.range_rate_mps) >= radar.min_speed_mps
        echoes.append(np.column_stack([seen.xyz[moving, :2], seen.range_rate_mps[moving]]))
        rows = np.column_stack([seen.xyz, np.nan_to_num(seen.range_rate_mps)]).astype(np.float32)
        drawn.append(BevPoints(lidar_rows(xyz, height), rows))
        if len(clouds) == NUM_FRAMES:
            break
    rig = thesis_rig().rig()
    print(
        f"points {np.mean([len(x) for x in clouds]):.0f}, obstacles {np.mean([len(x) for x in clusters]):.0f}, "
        f"moving echoes {np.mean([len(x) for x in echoes]):.0f}, {len(clouds)} frames, torch {torch.__version__}"
    )
    eps, few = lidar.cluster.eps_m, lidar.cluster.min_points
    image = [rasterize(one)[None] for one in drawn]
    network, camera = BevNetwork().eval(), CityDetector(7).eval()
    detector = open_detector(BevParams(threads=2))
    devices = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    print(f"{'step':34}{'kernels':>10}" + "".join(f"{'torch ' + d:>12}" for d in devices))

    def row(name: str, on_cpu: Callable[[Any], object] | None, arrays: list[Any], twin: Callable[[Any], object],
            convert: Callable[[Any, str], Any] = lambda one, d: torch.from_numpy(one).to(d)) -> None:  # fmt: skip
        cells = [median_ms(on_cpu, arrays, "cpu") if on_cpu else float("nan")]
        for device in devices:
            if device == "cpu" and name.startswith("DBSCAN"):  # all pairs take seconds there
                cells.append(float("nan"))
                continue
            with torch.no_grad():
                cells.append(median_ms(twin, [convert(one, device) for one in arrays], device))
        print(f"{name:34}{cells[0]:10.2f}" + "".join(f"{ms:12.2f}" for ms in cells[1:]), flush=True)

    row(
        "projection",
        lambda x: project_body(rig, "camera", x),
        clouds,
        lambda x: projection.project_body(rig, "camera", x),
    )
    row(
        "ground",
        lambda x: ground.find_ground(x, lidar.ground),
        clouds,
        lambda x: ground_twin.find_ground(x, lidar.ground),
    )
    row("DBSCAN, LiDAR", lambda x: dbscan(x, eps, few), clusters, lambda x: clustering.dbscan(x, eps, few))
    row("DBSCAN, radar", lambda x: dbscan(x, 2.0, 5), echoes, lambda x: clustering.dbscan(x, 2.0, 5))
    row("DBSCAN, whole LiDAR cloud", lambda x: dbscan(x, 0.5, 5), clouds, lambda x: clustering.dbscan(x, 0.5, 5))
    for device in devices:
        print(
            f"{'rasterize, with transfer, ' + device:34}{median_ms(rasterize, drawn, 'cpu'):10.2f}"
            f"{median_ms(partial(draw, device), drawn, device):12.2f}"
        )
    for device in devices:
        net, eye = network.to(device), camera.to(device)
        with torch.no_grad():
            alone = median_ms(net, [torch.from_numpy(one).to(device) for one in image[:6]], device)
            looked = median_ms(eye, [torch.rand(1, 3, 480, 640, device=device)], device)
        print(f"{'networks, torch ' + device:34}bird's eye {alone:.2f} ms, camera {looked:.2f} ms")
    print(
        f"bird's eye, onnxruntime, 2 threads, drawing and decoding included "
        f"{median_ms(lambda one: detector.detect(one, Plane(0, 0, 0), 0.4), drawn, 'cpu'):.2f} ms ({BUILTIN.name})"
    )
    assert image[0].shape == (1, NUM_CHANNELS, SIDE, SIDE)


main(Path(sys.argv[1]))
