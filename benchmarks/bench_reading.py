"""Reading an MCAP log into our types, against the mcap library with CRCs on plus protobuf parsing, in one process."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from mcap.reader import make_reader

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

NUM_FRAMES, NUM_POINTS = 850, 50_000  # About 1 GB
UPRIGHT = np.array([0.0, 0, 0, 1])
RIG = Rig(
    {"lidar": Mount("lidar", np.zeros(3), UPRIGHT), "camera": Mount("camera", np.zeros(3), UPRIGHT)},
    {"camera": CameraModel(np.eye(3), (1280, 720))},
)


def write(path: Path, compression: str) -> None:
    rng = np.random.Generator(np.random.Philox(1))
    noise = rng.integers(0, 255, (720, 1280, 3)).astype(np.uint8)
    jpeg = encode_jpeg(noise, 60)
    with McapWriter(path, LogInfo("bench", "bench"), RIG, compression) as log:
        for i in range(NUM_FRAMES):
            stamp = 1_000_000_000 + 100_000_000 * i
            xyz = rng.uniform(-80, 80, (NUM_POINTS, 3)).astype(np.float32)
            ring = rng.integers(0, 64, NUM_POINTS).astype(np.uint16)
            log.write(PointCloud("lidar", stamp, stamp, xyz, xyz[:, 0].copy(), ring))
            log.write(Image("camera", stamp, stamp, jpeg, "jpeg", (1280, 720)))


def ours(path: Path) -> int:
    return sum(1 for _ in open_log(path, FaultLog()).messages())


def library(path: Path) -> int:
    kinds: dict[str, type[CompressedImage | CloudProto]] = {
        "foxglove.CompressedImage": CompressedImage,
        "foxglove.PointCloud": CloudProto,
    }
    num = 0
    with path.open("rb") as stream:
        for schema, _, message in make_reader(stream, validate_crcs=True).iter_messages():
            if schema is not None and schema.name in kinds:
                kinds[schema.name].FromString(message.data)
                num += 1
    return num


def best_s(read: Callable[[Path], int], path: Path) -> float:
    times = []
    for _ in range(3):
        start = time.perf_counter()
        assert read(path) == 2 * NUM_FRAMES
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("none", "lz4", "zstd"):
            path = Path(folder) / f"{compression}.mcap"
            write(path, compression)
            a, b, size = best_s(ours, path), best_s(library, path), path.stat().st_size
            rate = size / 1e6 / a
            print(f"reading {compression}: {rate:.0f} MB/s, {b / a:.2f} times the mcap library's throughput")


if __name__ == "__main__":
    main()
