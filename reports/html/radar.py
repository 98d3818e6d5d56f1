"""What must be known about radar velocities before their colours are read."""

import math
from collections.abc import Sequence

from fbench.replay.store import Run
from fbench.reports.html.text import number

_PERIOD_KEY = "radar.velocity_period_mps"


def velocity_periods(runs: Sequence[Run]) -> list[str]:
    """Return the periods [m/s] with which radial velocities alias, as the metadata of the runs' logs say."""
    texts = dict.fromkeys(run.manifest.log.metadata.get(_PERIOD_KEY, "") for run in runs)
    return list(dict.fromkeys(number(period, 2) for period in map(_period, texts) if period))


def _period(text: str) -> float:
    """Return 0 where `text` is no positive number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) and value > 0 else 0.0
