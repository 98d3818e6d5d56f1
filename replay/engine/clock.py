"""The clock: how fast log time passes. It paces the wall clock and changes nothing else."""

import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64, Int64

MAX_GAP_NS = 2_000_000_000
_BEGINS = -(2**63)


@dataclass(frozen=True)
class Pace:
    """How fast log time passed; pauses of the log are left out."""

    asked: float | None  # Multiple of real time; `None`: as fast as possible
    achieved: float | None  # `None` where no time passed
    p99_late_ms: float | None = None
    """How much later than asked for 99 % of the messages went on at most; `None` where no pace was asked for."""
    max_late_ms: float | None = None
    drift_ms_per_min: float | None = None
    """By how much the schedule moved: least lateness in the last third of the time, less that in the first third. What
    else the machine does only makes messages later, so the least lateness tells. `None`: no pace was asked for."""


class Clock:
    """Log time passes `rate` times as fast as the wall clock; `None`: as fast as the pipeline works. Waits are
    absolute, so that no drift adds up. A pause in the log of more than `max_gap_ns` neither counts nor is waited for.
    """

    def __init__(
        self,
        rate: float | None = None,
        max_gap_ns: int = MAX_GAP_NS,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep_s: Callable[[float], None] = time.sleep,
    ) -> None:
        self._rate, self._max_gap_ns, self._now_ns, self._sleep_s = rate, max_gap_ns, now_ns, sleep_s
        self._passed_log_ns, self._passed_wall_ns = 0, 0
        self._start, self._last = (0, 0), (0, 0)  # Log time and wall time
        self._is_new, self._late_ns, self._due_ns = True, array("q"), array("q")

    def wait_until(self, log_ns: int) -> None:
        """Return when log time `log_ns` has come: at once without a rate, or where the pipeline is too slow."""
        now_ns = self._now_ns()
        begins, self._is_new = self._is_new or log_ns - self._last[0] > self._max_gap_ns, False
        if self._rate is not None:
            self._start = (log_ns, now_ns) if begins else self._start
            due_ns = self._start[1] + int((log_ns - self._start[0]) / self._rate)
            if due_ns > now_ns:
                self._sleep_s((due_ns - now_ns) / 1e9)
                now_ns = self._now_ns()
            self._late_ns.append(max(0, now_ns - due_ns))
            self._due_ns.append(_BEGINS if begins else due_ns)
        if not begins:
            self._passed_log_ns += log_ns - self._last[0]
            self._passed_wall_ns += now_ns - self._last[1]
        self._last = (log_ns, now_ns)

    @property
    def rate(self) -> float | None:
        """How fast log time passes, as asked; `None`: as fast as the pipeline works."""
        return self._rate

    @property
    def pace(self) -> Pace:
        """How fast log time passed so far, and how late waits returned."""
        log_ns, wall_ns = self._passed_log_ns, self._passed_wall_ns
        achieved = log_ns / wall_ns if log_ns > 0 and wall_ns > 0 else None
        if not self._late_ns:
            return Pace(self._rate, achieved)
        late_ms = np.array(self._late_ns) / 1e6
        p99 = float(np.percentile(late_ms, 99, method="higher"))
        return Pace(self._rate, achieved, p99, float(late_ms.max()), _drift(np.array(self._due_ns), late_ms))


def _drift(due_ns: Int64, late_ms: Float64) -> float | None:
    """Drift [ms per minute] of messages (N,) by when they were due, ascending; `None`: they span no time."""
    waited = due_ns != _BEGINS  # the others set the schedule, and aren't late
    due_ns, late_ms = due_ns[waited], late_ms[waited]
    if not len(due_ns):
        return None
    third_ns = (int(due_ns[-1]) - int(due_ns[0])) / 3
    if not third_ns:
        return None
    first, last = due_ns <= due_ns[0] + third_ns, due_ns >= due_ns[-1] - third_ns
    ends = [int(np.argmin(np.where(part, late_ms, np.inf))) for part in (first, last)]
    minutes = (due_ns[ends[1]] - due_ns[ends[0]]) / 60e9
    return float((late_ms[ends[1]] - late_ms[ends[0]]) / minutes)


def make_clock(rate: str, max_gap_ns: int) -> Clock:
    """Return the clock for `max` or a positive number. Raises ConfigError for anything else."""
    if rate == "max":
        return Clock(None, max_gap_ns)
    try:
        factor = float(rate)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise ConfigError(f"--rate {rate}: expected 'max' or a positive number, such as 0.5 or 10")
    return Clock(factor, max_gap_ns)
