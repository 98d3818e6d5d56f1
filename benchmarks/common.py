"""Shared parts of the benchmarks: times, threads, peak memory, logs of the city and of noise."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.request import CityRequest
from fbench.datasets.importing.run import write_recording
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.frames import FrameStream
from fbench.replay.geometry.threads import VARIABLE
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.setup import StampParams
from fbench.replay.setup.source import LogRequest, log_source

SENSORS = ("camera", "lidar", "radar")
UPRIGHT = np.array([0.0, 0, 0, 1])
NOISE_POINTS, NOISE_PERIOD_NS = 50_000, 100_000_000
NOISE_RIG = Rig(
    {"lidar": Mount("lidar", np.array([0, 0, 1.9]), UPRIGHT), "camera": Mount("camera", np.zeros(3), UPRIGHT)},
    {"camera": CameraModel(np.array([[600.0, 0, 640], [0, 600, 360], [0, 0, 1]]), (1280, 720))},
)
NOISE_INFO = LogInfo("bench", "bench")
_CHILD = """
import resource, sys
from fbench.cli import main
try:
    main()
except SystemExit as end:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, end.code or 0, file=sys.stderr)
"""


def best_s(function: Callable[[], object], repeat: int = 5, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the shortest time of some calls; `time.process_time` leaves out what else the machine does."""
    times = []
    for _ in range(repeat):
        start = clock()
        function()
        times.append(clock() - start)
    return min(times)


def best_by_turns_s(
    functions: Mapping[str, Callable[[], object]], rounds: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Return the shortest of some rounds by name, in each of which all run, so that a busy machine is so for all."""
    times = [{name: best_s(function, 1, clock) for name, function in functions.items()} for _ in range(rounds)]
    return {name: min(taken[name] for taken in times) for name in functions}


@contextmanager
def threads(num: int) -> Iterator[None]:
    """Have the pipelines that are made meanwhile use so many."""
    os.environ[VARIABLE] = str(num)
    yield
    del os.environ[VARIABLE]


def peak_kib(*command: str) -> int:
    """Return the peak memory of an fbench command in a fresh process."""
    result = subprocess.run([sys.executable, "-c", _CHILD, *command], capture_output=True, text=True, check=False)
    kib, code = result.stderr.split()[-2:]
    assert code == "0", result.stderr
    return int(kib)


def noise_messages(num_frames: int) -> Iterator[PointCloud | Image]:
    """Yield a cloud and an image of noise a frame, ten frames a second."""
    rng = np.random.Generator(np.random.Philox(1))
    jpeg = encode_jpeg(rng.integers(0, 255, (720, 1280, 3)).astype(np.uint8), 60)
    for i in range(num_frames):
        stamp = 1_000_000_000 + NOISE_PERIOD_NS * i
        xyz = rng.uniform(-80, 80, (NOISE_POINTS, 3)).astype(np.float32)
        ring = rng.integers(0, 64, NOISE_POINTS).astype(np.uint16)
        yield PointCloud("lidar", stamp, stamp, xyz, xyz[:, 0].copy(), ring)
        yield Image("camera", stamp, stamp, jpeg, "jpeg", (1280, 720))


def frames_of(log: Path) -> tuple[Rig, LogInfo, list[Frame]]:
    """Return rig, description and all frames of a log, held in memory."""
    faults = FaultLog()
    reader = log_source(LogRequest(log)).open(faults)
    stream = FrameStream(reader, SyncParams(), StampParams(), Excerpt(), Clock(), faults)
    return stream.rig, reader.info, list(stream.frames(reader))


def write_missing(recording: CityRecording, out: Path) -> Path:
    """Write a drive, unless it is there."""
    if not out.exists():
        write_recording(recording, Target(out), lambda name, done, total: None)
    return out


def write_drive(out: Path, world: str, seconds: float, seed: int, sensors: Sequence[str] = SENSORS) -> Path:
    """Simulate a drive on a clear day with these sensors of the thesis's rig, unless it is there."""
    spec = CityRequest(world, seconds=seconds, seed=seed, sensors=sensors).spec()
    return write_missing(CityRecording(spec, out.stem), out)


def images_and_truth(log: CityRecording) -> tuple[dict[int, Image], dict[int, Boxes2D]]:
    """Return the images of a drive with one camera, and what is true of them, by stamp."""
    images: dict[int, Image] = {}
    truth: dict[int, Boxes2D] = {}
    for item in log.items():
        if isinstance(item, Image):
            images[item.stamp_ns] = item
        elif isinstance(item, Truth) and item.boxes2d is not None:
            truth[item.stamp_ns] = item.boxes2d
    return images, truth
