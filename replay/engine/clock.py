"""Clocks: how fast log time passes. They pace the wall clock and change nothing else."""

import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import ConfigError

MAX_GAP_NS = 2_000_000_000


@dataclass(frozen=True)
class Pace:
    """How fast log time passed; pauses of the log are left out."""

    asked: float | None  # Multiple of real time; `None`: as fast as possible
    achieved: float | None  # `None` where no time passed
    p99_late_ms: float | None = None
    """How much later than asked for 99 % of the messages went on at most; `None` where no pace was asked for."""
    max_late_ms: float | None = None


class VirtualClock:
    """Log time passes as fast as the pipeline works. Pauses of the log of more than `max_gap_ns` don't count."""

    def __init__(self, max_gap_ns: int = MAX_GAP_NS, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._max_gap_ns, self._now_ns = max_gap_ns, now_ns
        self._passed_log_ns, self._passed_wall_ns = 0, 0
        self._last: tuple[int, int] | None = None  # Log time and wall time

    def wait_until(self, log_ns: int) -> None:
        """Return when log time `log_ns` has come: at once."""
        self._note(log_ns, self._now_ns())

    @property
    def pace(self) -> Pace:
        """How fast log time passed so far."""
        return Pace(None, self._rate)

    def _note(self, log_ns: int, now_ns: int) -> None:
        """Log time `log_ns` is reached at `now_ns`."""
        if self._last is not None and log_ns - self._last[0] <= self._max_gap_ns:
            self._passed_log_ns += log_ns - self._last[0]
            self._passed_wall_ns += now_ns - self._last[1]
        self._last = (log_ns, now_ns)

    @property
    def _rate(self) -> float | None:
        log_ns, wall_ns = self._passed_log_ns, self._passed_wall_ns
        return log_ns / wall_ns if log_ns > 0 and wall_ns > 0 else None


class PacedClock(VirtualClock):
    """Log time passes `rate` times as fast as the wall clock; waits are absolute, so that no drift adds up. A pause in
    the log of more than `max_gap_ns` isn't waited for.
    """

    def __init__(
        self,
        rate: float,
        max_gap_ns: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep_s: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(max_gap_ns, now_ns)
        self._asked, self._sleep_s, self._start = rate, sleep_s, (0, 0)
        self._late_ns = array("q")

    def wait_until(self, log_ns: int) -> None:
        """Sleep until the wall clock has reached `log_ns`; a pipeline that is too slow isn't waited for."""
        now_ns = self._now_ns()
        if self._last is None or log_ns - self._last[0] > self._max_gap_ns:
            self._start = (log_ns, now_ns)
        log_start, wall_start = self._start
        due_ns = wall_start + int((log_ns - log_start) / self._asked)
        if due_ns > now_ns:
            self._sleep_s((due_ns - now_ns) / 1e9)
            now_ns = self._now_ns()
        self._late_ns.append(max(0, now_ns - due_ns))
        self._note(log_ns, now_ns)

    @property
    def pace(self) -> Pace:
        """How fast log time passed so far, and how late waits returned."""
        if not self._late_ns:
            return Pace(self._asked, None)
        late_ms = np.array(self._late_ns) / 1e6
        p99 = float(np.percentile(late_ms, 99, method="higher"))
        return Pace(self._asked, self._rate, p99, float(late_ms.max()))


def make_clock(rate: str, max_gap_ns: int) -> VirtualClock:
    """Return the clock for `max` or a positive number. Raises ConfigError for anything else."""
    if rate == "max":
        return VirtualClock(max_gap_ns)
    try:
        factor = float(rate)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise ConfigError(f"--rate {rate}: expected 'max' or a positive number, such as 0.5 or 10")
    return PacedClock(factor, max_gap_ns)
