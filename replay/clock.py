"""Clocks: how fast log time passes. They pace the wall clock and change nothing else."""

import time
from collections.abc import Callable
from typing import Protocol

from fbench.replay.errors import ConfigError


class Clock(Protocol):
    """Lets log time pass."""

    def wait_until(self, log_ns: int) -> None:
        """Return when log time `log_ns` has come."""
        ...


class VirtualClock:
    """Log time passes as fast as the pipeline works."""

    def wait_until(self, log_ns: int) -> None:
        """Return at once."""


class PacedClock:
    """Log time passes `rate` times as fast as the wall clock; waits are absolute, so that no drift adds up.

    A pause in the log of more than `max_gap_ns` isn't waited for.
    """

    def __init__(
        self,
        rate: float,
        max_gap_ns: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep_s: Callable[[float], None] = time.sleep,
    ) -> None:
        self._rate, self._max_gap_ns, self._now_ns, self._sleep_s = rate, max_gap_ns, now_ns, sleep_s
        self._anchor: tuple[int, int] | None = None
        self._last_ns = 0

    def wait_until(self, log_ns: int) -> None:
        """Sleep until the wall clock has reached `log_ns`; a pipeline that is too slow isn't waited for."""
        if self._anchor is None or log_ns - self._last_ns > self._max_gap_ns:
            self._anchor = (log_ns, self._now_ns())
        self._last_ns = log_ns
        log_start, wall_start = self._anchor
        behind_ns = wall_start + int((log_ns - log_start) / self._rate) - self._now_ns()
        if behind_ns > 0:
            self._sleep_s(behind_ns / 1e9)


def make_clock(rate: str, max_gap_ns: int) -> Clock:
    """Return the clock for `max` or a positive number.

    Raises:
        ConfigError: for anything else.
    """
    if rate == "max":
        return VirtualClock()
    try:
        factor = float(rate)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise ConfigError(f"--rate {rate}: expected 'max' or a positive number, such as 0.5 or 10")
    return PacedClock(factor, max_gap_ns)
