"""Circumstances that must not matter."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fbench.replay.read_ahead import DEFAULT
from fbench.replay.threads import VARIABLE
from fbench.replay.verify.task import Form, Task

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", VARIABLE)
PACED_S = 2.0
"""Wall time that a paced replay waits for log time."""


@dataclass(frozen=True)
class Variant:
    """One way to replay."""

    name: str
    rate: str = "max"
    read_ahead: int | None = DEFAULT
    form: Form | None = None
    num_threads: int = 1
    hash_seed: str = "0"
    environment: Mapping[str, str] = field(default_factory=dict)
    elsewhere: bool = False
    """In another working directory."""

    def task(self, base: Task, folder: Path) -> Task:
        """The base's task under these circumstances."""
        return replace(
            base,
            folder=folder,
            rate=self.rate,
            read_ahead=self.read_ahead,
            form=self.form,
            num_threads=self.num_threads,
        )

    def variables(self) -> dict[str, str]:
        """What the process finds in its environment beside what is there anyway."""
        threads = dict.fromkeys(_THREADS, str(self.num_threads))
        return {**threads, "PYTHONHASHSEED": self.hash_seed, **self.environment}


BASE = Variant("reference")


def variants(num_repeats: int, span_s: float, quick: bool) -> tuple[Variant, ...]:
    """All circumstances to try, or only those that find most.

    Args:
        num_repeats: How often the same is replayed, the reference included.
        span_s: How long the log is, without pauses.
        quick: Leave out rates, reading ahead and containers.
    """
    repeats = tuple(Variant(f"repeat {i}" if num_repeats > 2 else "repeat") for i in range(1, num_repeats))
    few = (*repeats, Variant("hash seed 1", hash_seed="1"), Variant("2 threads", num_threads=2))
    if quick:
        return few
    paced = f"{span_s / PACED_S:.4g}" if span_s else "1"
    abroad = {"TZ": "Asia/Kathmandu", "LC_ALL": "tr_TR.UTF-8"}
    return (
        *few,
        Variant("random hash seed", hash_seed="random"),
        Variant(f"rate {paced}", rate=paced),
        Variant("no read-ahead", read_ahead=0),
        Variant("read-ahead of all", read_ahead=None),
        Variant("other time zone, locale and folder", environment=abroad, elsewhere=True),
        Variant("MCAP unchunked", form="unchunked"),
        Variant("MCAP lz4", form="lz4"),
        Variant("MCAP in small chunks", form="small chunks"),
        Variant("Parquet", form="parquet"),
    )
