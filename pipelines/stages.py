"""Timing of the stages of one frame."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StageClock:
    """Measures the wall time of named stages, in the order in which they first ran.

    The standard names are `decode`, `preprocess`, `calibrate`, `detect.camera`, `detect.lidar`, `detect.radar`,
    `fuse` and `track`.
    """

    def __init__(self) -> None:
        self.stage_ns: dict[str, int] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside the `with` block to stage `name`."""
        start = time.perf_counter_ns()
        try:
            yield
        finally:
            self.stage_ns[name] = self.stage_ns.get(name, 0) + time.perf_counter_ns() - start

    def include(self, other: "StageClock") -> None:
        """Add the times of another clock, which measured other stages, or others of the same name."""
        for name, ns in other.stage_ns.items():
            self.stage_ns[name] = self.stage_ns.get(name, 0) + ns
