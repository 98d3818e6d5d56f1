"""Checks of parameters, and timing of the stages of one frame."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import TypeVar

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.runs.digest import digest

LIMIT = 1e6  # No parameter is sensible beyond this; keeps numbers that follow from them finite


def require_between(name: str, value: float, low: float, high: float = LIMIT) -> None:
    """Refuse a parameter outside of [low, high]. Raises ConfigError naming the parameter, what is expected and what was
    given.
    """
    if not low <= value <= high:
        limits = f"between {low:g} and {high:g}"
        if high == LIMIT:
            limits = f"at most {high:g}" if value > high else f"at least {low:g}"
        # Integers may be too large for a float's format.
        raise ConfigError(f"{name}: expected {limits}, got {value if isinstance(value, int) else format(value, 'g')}")


@dataclass(frozen=True)
class CheckedParams:
    """Parameters with ranges: see `in_range`. A subclass names what precedes its fields, such as `prefix="fusion"`.
    Raises ConfigError where a value is out of range: see `require_between`.
    """

    def __init_subclass__(cls, prefix: str = "") -> None:
        if prefix:
            cls._prefix = f"{prefix}."

    def __post_init__(self) -> None:
        for f in fields(self):
            if "range" in f.metadata and (value := getattr(self, f.name)) is not None:
                require_between(f"{self._prefix}{f.name}", value, *f.metadata["range"])

    _prefix = ""


T = TypeVar("T", int, float, None)


def in_range(default: T, low: float, high: float = LIMIT) -> T:
    """Field of `CheckedParams` whose values lie in [low, high]; `None`, where its type allows that, is always fine."""
    return field(default=default, metadata={"range": (low, high)})


def synchronize_cuda() -> None:
    """Wait for what torch has left to compute on a CUDA device; free where nothing is."""
    cuda = sys.modules.get("torch.cuda")
    if cuda is not None and cuda.is_initialized():
        cuda.synchronize()


class StageClock:
    """Measures the time of named stages, in the order in which they first ran: of the wall, and of the processor, as
    far as the thread that runs the stage used it. A stage ends when CUDA devices are done with it.

    The standard names are `decode`, `preprocess`, `calibrate`, `detect.camera`, `detect.lidar`, `detect.radar`,
    `fuse` and `track`.
    """

    def __init__(self) -> None:
        self.stage_ns: dict[str, int] = {}
        self.cpu_ns: dict[str, int] = {}
        self.digests: dict[str, str] = {}
        """Of what stages gave, so that it can be told where two runs differ first."""

    def note(self, name: str, result: object) -> None:
        """Keep the digest of what a stage gave, see `replay.runs.digest.Digest.add` for what it may hold."""
        self.digests[name] = digest(result)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside the `with` block to stage `name`."""
        start, cpu_start = time.perf_counter_ns(), time.thread_time_ns()
        try:
            yield
        finally:
            synchronize_cuda()
            cpu_ns = time.thread_time_ns() - cpu_start
            self._add(name, time.perf_counter_ns() - start, cpu_ns)

    def include(self, other: "StageClock") -> None:
        """Add the times of another clock, which measured other stages, or others of the same name."""
        for name, ns in other.stage_ns.items():
            self._add(name, ns, other.cpu_ns[name])
        self.digests |= other.digests

    def _add(self, name: str, ns: int, cpu_ns: int) -> None:
        self.stage_ns[name] = self.stage_ns.get(name, 0) + ns
        self.cpu_ns[name] = self.cpu_ns.get(name, 0) + cpu_ns
