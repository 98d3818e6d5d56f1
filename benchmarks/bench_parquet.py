"""Reading Parquet logs into our types, against MCAP logs with the same messages, in one process."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Message, PointCloud
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.reader import LogReader

NUM_FRAMES, NUM_POINTS, NUM_RUNS = 200, 50_000, 5
UPRIGHT = np.array([0.0, 0, 0, 1])
RIG = Rig(
    {"lidar": Mount("lidar", np.zeros(3), UPRIGHT), "camera": Mount("camera", np.zeros(3), UPRIGHT)},
    {"camera": CameraModel(np.eye(3), (1280, 720))},
)
INFO = LogInfo("bench", "bench")


def messages() -> Iterator[Message]:
    rng = np.random.Generator(np.random.Philox(1))
    jpeg = encode_jpeg(rng.integers(0, 255, (720, 1280, 3)).astype(np.uint8), 60)
    for i in range(NUM_FRAMES):
        stamp = 1_000_000_000 + 100_000_000 * i
        xyz = rng.uniform(-80, 80, (NUM_POINTS, 3)).astype(np.float32)
        ring = rng.integers(0, 64, NUM_POINTS).astype(np.uint16)
        yield PointCloud("lidar", stamp, stamp, xyz, xyz[:, 0].copy(), ring)
        yield Image("camera", stamp, stamp, jpeg, "jpeg", (1280, 720))


def write(mcap: Path, parquet: Path, compression: str) -> None:
    with McapWriter(mcap, INFO, RIG, compression) as a, ParquetWriter(parquet, INFO, RIG, compression) as b:
        for message in messages():
            a.write(message)
            b.write(message)


def read_s(reader: LogReader) -> float:
    """Seconds that one pass takes."""
    start = time.perf_counter()
    num = sum(1 for _ in reader.messages())
    seconds = time.perf_counter() - start
    assert num == 2 * NUM_FRAMES
    return seconds


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("none", "zstd"):
            mcap, parquet = Path(folder) / f"{compression}.mcap", Path(folder) / f"{compression}.parquetlog"
            write(mcap, parquet, compression)
            a, b = [], []
            for _ in range(NUM_RUNS):  # alternating, so that other load meets both
                a.append(read_s(LogReader(McapFile(mcap, FaultLog()))))
                b.append(read_s(LogReader(ParquetFolder(parquet, FaultLog()))))
            size = mcap.stat().st_size / 1e6
            print(
                f"reading {compression}: MCAP {size / min(a):.0f} MB/s, Parquet {size / min(b):.0f} MB/s, "
                f"{min(a) / min(b):.2f} times MCAP's throughput"
            )


if __name__ == "__main__":
    main()
