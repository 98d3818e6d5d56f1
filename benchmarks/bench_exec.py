"""Cost of `exec` for a frame of 50,000 LiDAR points: the C++ echo client against the same pipeline in this process."""

import shutil
import subprocess
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from fbench.pipelines.external.pipeline import Exec, ExecParams
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig

NUM_POINTS, NUM_FRAMES = 50_000, 300
SOURCES = Path(__file__).resolve().parents[1] / "examples" / "exec" / "cpp"
RIG = Rig({"lidar": Mount("lidar", np.zeros(3), np.array([0, 0, 0, 1.0]))}, {})


class Echo:
    """A box at the first point."""

    def start(self, rig: Rig, log_info: LogInfo) -> None: ...

    def reset(self, reason: str) -> None: ...

    def step(self, frame: Frame) -> Output:
        clouds = [m for m in frame.messages.values() if isinstance(m, PointCloud) and len(m.xyz)]
        first = np.array([cloud.xyz[0] for cloud in clouds], np.float64).reshape(-1, 3)
        boxes = Boxes3D(first, np.ones_like(first), np.zeros(len(first)), score=np.ones(len(first)))
        return Output(boxes, Boxes3D.empty(), {})


def milliseconds(pipeline: Pipeline) -> tuple[float, float]:
    """Median and 95th percentile of a step."""
    rng = np.random.Generator(np.random.Philox(key=0))
    xyz, intensity = rng.normal(0, 20, (NUM_POINTS, 3)).astype(np.float32), rng.random(NUM_POINTS, np.float32)
    ring = rng.integers(0, 64, NUM_POINTS).astype(np.uint16)
    message = PointCloud("lidar", 0, 0, xyz, intensity, ring, np.arange(NUM_POINTS, dtype=np.int32))
    pipeline.start(RIG, LogInfo("bench", "bench"))
    times = []
    for i in range(NUM_FRAMES):
        frame = Frame(i, i, 0, {"lidar": message})
        begin = time.perf_counter_ns()
        pipeline.step(frame)
        times.append(time.perf_counter_ns() - begin)
    median, p95 = np.percentile(np.array(times) / 1e6, [50, 95])
    return float(median), float(p95)


def main() -> None:
    cmake = shutil.which("cmake")
    if not cmake or not shutil.which("g++"):
        print("exec: skipped, no cmake or no g++ here")
        return
    with tempfile.TemporaryDirectory() as folder:
        for arguments in (["-S", str(SOURCES), "-B", folder], ["--build", folder, "--target", "echo"]):
            subprocess.run([cmake, *arguments], check=True, stdout=subprocess.DEVNULL)
        with closing(Exec(ExecParams(f"{folder}/echo"))) as pipeline:
            outside, p95 = milliseconds(pipeline)
    inside, _ = milliseconds(Echo())
    frame = f"exec, {NUM_POINTS} points ({NUM_POINTS * 22 / 1e6:.1f} MB) a frame"
    more = f"+{outside - inside:.3f} ms, ratio {outside / inside:.0f} (under 1 ms wanted)"
    print(f"{frame}: {outside:.3f} ms (p95 {p95:.3f}), in process {inside:.3f} ms: {more}")


if __name__ == "__main__":
    main()
