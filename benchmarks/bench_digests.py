"""Cost of digests of messages and outputs in a replay through lidar3d: with and without them, in one process."""

import tempfile
import time
from pathlib import Path
from unittest.mock import patch

from common import write_drive

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.digest import START

LOG_S = 10.0  # 100 frames


class NoDigest:
    def add(self, value: object) -> None: ...

    def hex(self) -> str:
        return START


def seconds(log: Path, folder: Path) -> float:
    pipeline, parameters = make_pipeline("lidar3d", [])
    faults = FaultLog()
    reader = open_log(log, faults)
    start = time.perf_counter()
    replay(reader, Plan(pipeline, "lidar3d", parameters), folder, faults, overwrite=True)
    return time.perf_counter() - start


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = write_drive(folder / "log.mcap", "urban", LOG_S, 101, ["lidar", "radar"])
        seconds(log, folder / "run")
        pairs = []
        for _ in range(5):
            with (
                patch("fbench.replay.engine.frames.Digest", NoDigest),
                patch("fbench.replay.engine.loop.digest", lambda content: START),
            ):
                bare = seconds(log, folder / "run")
            pairs.append((seconds(log, folder / "run"), bare))
        with_digests, bare = (min(column) for column in zip(*pairs, strict=True))
        share = with_digests / bare - 1
        print(f"lidar3d with digests {with_digests:.2f} s, without {bare:.2f} s: {share:+.1%} (at most 5 % wanted)")


if __name__ == "__main__":
    main()
