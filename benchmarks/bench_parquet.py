"""Reading Parquet logs into our types, against MCAP logs with the same messages, in one process."""

import tempfile
import time
from pathlib import Path

from common import NOISE_INFO, NOISE_RIG, noise_messages

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.reader import LogReader

NUM_FRAMES, NUM_RUNS = 200, 5


def write(mcap: Path, parquet: Path, compression: str) -> None:
    with (
        McapWriter(mcap, NOISE_INFO, NOISE_RIG, compression) as a,
        ParquetWriter(parquet, NOISE_INFO, NOISE_RIG, compression) as b,
    ):
        for message in noise_messages(NUM_FRAMES):
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
