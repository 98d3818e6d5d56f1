"""How many threads kernels and detectors use."""

import os

VARIABLE = "FBENCH_THREADS"
"""Environment variable that says so; `fbench bench` sets it to 1 in each of its worker processes."""


def num_threads() -> int:
    """As many as `FBENCH_THREADS` says, at least one; without it, one for each processor that this process may use. A
    value that is no number counts as none. Results never depend on it.
    """
    given = os.environ.get(VARIABLE, "").strip()
    if given.isdecimal():
        return max(1, int(given))
    return len(os.sched_getaffinity(0))
