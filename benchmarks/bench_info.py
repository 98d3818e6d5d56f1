"""Bytes that `fbench log info` reads of a large indexed MCAP file, and its time beyond start-up.

python benchmarks/bench_info.py [GIGABYTES]
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import UPRIGHT

from fbench.replay.check.survey import Survey, survey
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Image, PointCloud, Pose, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

NUM_POINTS, IMAGE_BYTES, POSES_A_FRAME = 50_000, 400_000, 10
CAMERAS = ("left", "right")
MOUNTS = {name: Mount("camera", np.zeros(3), UPRIGHT) for name in CAMERAS}
RIG = Rig(
    {"lidar": Mount("lidar", np.zeros(3), UPRIGHT), **MOUNTS},
    {name: CameraModel(np.eye(3), (1280, 720)) for name in CAMERAS},
)


def write(path: Path, num_bytes: int) -> None:
    """Uncompressed clouds, images, poses at 100 Hz and empty truth, until the file is as large as wanted."""
    rng = np.random.Generator(np.random.Philox(1))
    xyz = rng.uniform(-80, 80, (NUM_POINTS, 3)).astype(np.float32)
    jpeg = rng.bytes(IMAGE_BYTES)
    num_frames = num_bytes // (NUM_POINTS * 16 + 2 * IMAGE_BYTES)
    with McapWriter(path, LogInfo("bench", "bench"), RIG, "none") as log:
        for i in range(num_frames):
            stamp = 1_000_000_000 + 100_000_000 * i
            log.write(PointCloud("lidar", stamp, stamp, xyz, xyz[:, 0].copy()))
            for name in CAMERAS:
                log.write(Image(name, stamp, stamp, jpeg, "jpeg", (1280, 720)))
            for k in range(POSES_A_FRAME):
                log.write(Pose("gnss", stamp + k * 10_000_000, stamp + k * 10_000_000, np.zeros(3), UPRIGHT))
            log.write(Truth(stamp, stamp))


def num_read() -> int:
    """Bytes that this process has read so far, whether from the disk or the cache."""
    lines = Path("/proc/self/io").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("rchar"))


def info(path: Path) -> Survey:
    return survey(open_log(path, FaultLog()), SyncParams())


def main() -> None:
    num_gb = float(sys.argv[1]) if len(sys.argv) > 1 else 0.4
    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder) / "small.mcap", Path(folder) / "large.mcap"
        write(small, 10_000_000)
        info(small)  # imports
        write(large, int(num_gb * 1e9))
        size, before, start = large.stat().st_size, num_read(), time.perf_counter()
        result = info(large)
        seconds, read = time.perf_counter() - start, num_read() - before
        assert result.breaks == ()
        print(f"info of {size / 1e9:.2f} GB, {result.num_frames} frames: {seconds:.3f} s, "
              f"{read / 1e6:.2f} MB read, {100 * read / size:.3f} % of the file")  # fmt: skip


if __name__ == "__main__":
    main()
