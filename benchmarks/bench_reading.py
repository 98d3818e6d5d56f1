"""Reading logs into our types: MCAP against the mcap library with CRCs on plus protobuf parsing, and Parquet against
MCAP with the same messages, in one process.
"""

import tempfile
from functools import partial
from pathlib import Path

from common import NOISE_INFO, NOISE_RIG, best_by_turns_s, best_s, noise_messages
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from mcap.reader import make_reader

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.open import open_log

NUM_FRAMES, NUM_PARQUET_FRAMES, NUM_RUNS = 850, 200, 5  # The first are about 1 GB


def write(writer: McapWriter | ParquetWriter, num_frames: int) -> None:
    with writer as log:
        for message in noise_messages(num_frames):
            log.write(message)


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


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("none", "lz4", "zstd"):
            path = Path(folder) / f"{compression}.mcap"
            write(McapWriter(path, NOISE_INFO, NOISE_RIG, compression), NUM_FRAMES)
            assert ours(path) == library(path) == 2 * NUM_FRAMES
            a, b = best_s(partial(ours, path), 3), best_s(partial(library, path), 3)
            rate = path.stat().st_size / 1e6 / a
            print(f"reading {compression}: {rate:.0f} MB/s, {b / a:.2f} times the mcap library's throughput")
        for compression in ("none", "zstd"):
            mcap, parquet = Path(folder) / f"{compression}.mcap", Path(folder) / f"{compression}.parquetlog"
            write(McapWriter(mcap, NOISE_INFO, NOISE_RIG, compression), NUM_PARQUET_FRAMES)
            write(ParquetWriter(parquet, NOISE_INFO, NOISE_RIG, compression), NUM_PARQUET_FRAMES)
            assert ours(mcap) == ours(parquet) == 2 * NUM_PARQUET_FRAMES
            a, b = best_by_turns_s({"mcap": partial(ours, mcap), "parquet": partial(ours, parquet)}, NUM_RUNS).values()
            size = mcap.stat().st_size / 1e6
            rates = f"MCAP {size / a:.0f} MB/s, Parquet {size / b:.0f} MB/s"
            print(f"reading {compression}: {rates}, {a / b:.2f} times MCAP's throughput")


if __name__ == "__main__":
    main()
