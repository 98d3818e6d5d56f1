"""What signals show."""

import numpy as np

from fbench.datasets.city.traffic.network import Network
from fbench.replay.arrays import Array

RED, YELLOW, GREEN = 0, 1, 2


def lights_at(net: Network, time_s: float) -> Array:
    """What the signal at each lane's end (L,) shows; `GREEN` where there is none."""
    since, green_s = (time_s - net.groups["green_from_s"]) % net.cycle_s, net.groups["green_s"]
    shown = np.where(since < green_s, GREEN, np.where(since < green_s + net.yellow_s, YELLOW, RED))
    return np.asarray(np.append(shown, GREEN)[net.lanes["signal"]])  # -1, for none, takes the last
