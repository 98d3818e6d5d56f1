"""Peak memory of replaying a log of 4 GB against one of 400 MB, each in a fresh process: it must not grow with length.

python benchmarks/bench_memory.py [GB of the longer one, default 4] [pipeline, default lidar3d]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import NOISE_PERIOD_NS, NOISE_POINTS, NOISE_RIG, peak_kib, write_drive

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import LogInfo
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log


def clouds(folder: Path) -> list[PointCloud]:
    """Some clouds of the city, filled up to `NOISE_POINTS` with points high above."""
    write_drive(folder / "city.mcap", "urban", 2.0, 101, ["lidar", "radar"])
    found = [m for m in open_log(folder / "city.mcap", FaultLog()).messages() if isinstance(m, PointCloud)]
    rng = np.random.Generator(np.random.Philox(1))
    sky = rng.uniform((-80, -80, 40), (80, 80, 60), (NOISE_POINTS, 3)).astype(np.float32)
    result = []
    for cloud in found:
        xyz = np.concatenate([cloud.xyz, sky])[:NOISE_POINTS]
        result.append(PointCloud("lidar", 0, 0, xyz, xyz[:, 0].copy(), np.zeros(NOISE_POINTS, np.uint16)))
    return result


def write(path: Path, num_bytes: float, sweeps: list[PointCloud]) -> None:
    noise = Image("camera", 0, 0, np.random.Generator(np.random.Philox(2)).bytes(200_000), "jpeg", (1280, 720))
    num = int(num_bytes / (NOISE_POINTS * 18 + len(noise.data)))
    with McapWriter(path, LogInfo("long", "long"), NOISE_RIG, "none") as log:
        for i in range(num):
            stamp = 1_000_000_000 + i * NOISE_PERIOD_NS
            log.write(replace(sweeps[i % len(sweeps)], stamp_ns=stamp, log_ns=stamp))
            log.write(replace(noise, stamp_ns=stamp, log_ns=stamp))


def main() -> None:
    gigabytes = float(sys.argv[1]) if len(sys.argv) > 1 else 4.0
    pipeline = sys.argv[2] if len(sys.argv) > 2 else "lidar3d"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sweeps = clouds(folder)
        peaks = []
        for size in (0.1 * gigabytes, gigabytes):
            path = folder / "long.mcap"
            write(path, 1e9 * size, sweeps)
            peaks.append(peak_kib("replay", str(path), "-p", pipeline, "--overwrite", "-o", f"{path}-run"))
            print(f"{path.stat().st_size / 1e9:.2f} GB: peak {peaks[-1] / 1024:.0f} MiB")
            path.unlink()
    print(f"peak memory over ten times the length: ratio {peaks[1] / peaks[0]:.3f} (at most 1.05 wanted)")


if __name__ == "__main__":
    main()
