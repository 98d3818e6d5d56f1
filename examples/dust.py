"""A condition in one file: dust in the air takes LiDAR points, the far ones first.

fbench replay log.mcap -p lidar3d --condition examples/dust.py:Dust:3
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.messages import PointCloud


class Dust:
    """A return from range r is lost with probability 1 - exp(-2 r / L): light passes the dust twice (Beer-Lambert)."""

    version = 1  # raise it whenever the same message would become another one
    kinds = ("lidar",)
    levels: ClassVar = {"range_m": (400.0, 200.0, 100.0, 50.0, 25.0)}  # L at severities 1 to 5

    def disturb(self, message: Measurement, level: Level, site: Site) -> list[Measurement]:
        if not isinstance(message, PointCloud):
            return [message]
        rng = site.rng_of(message)  # random numbers for this message alone; site.rng() gives those of the whole log
        range_m = np.linalg.norm(message.xyz, axis=1)
        is_kept = rng.random(len(range_m)) < np.exp(-2 * range_m / level["range_m"])
        fields = {name: getattr(message, name) for name in ("xyz", "intensity", "ring", "offset_ns")}
        kept = {name: values[is_kept] for name, values in fields.items() if values is not None}
        return [replace(message, **kept)]  # a new message: never change the one that came
