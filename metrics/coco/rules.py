"""What COCO fixes: thresholds, ranges of area, how many estimates of an image count."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Bool, Float64


@dataclass(frozen=True)
class AreaRange:
    """Sizes of boxes that count; others are ignored."""

    name: str
    """As in `aps`: empty for all."""
    low_px2: float
    high_px2: float
    """Both ends belong to it."""

    def holds(self, area_px2: Float64) -> Bool:
        """Tell which areas (N,) lie in it; unknown ones (NaN) do."""
        inside: Bool = ~((area_px2 < self.low_px2) | (area_px2 > self.high_px2))
        return inside


@dataclass(frozen=True)
class CocoRules:
    """Parameters of pycocotools' `Params` for boxes."""

    thresholds: tuple[float, ...] = tuple(np.linspace(0.5, 0.95, 10).tolist())
    """Least intersection over union; results are averaged over them."""
    num_recalls: int = 101
    """Precision is read at as many recalls from 0 to 1."""
    max_estimates: tuple[int, ...] = (1, 10, 100)
    """Of one class in one image, the best scores first; ascending."""
    areas: tuple[AreaRange, ...] = (
        AreaRange("", 0.0, 1e10),
        AreaRange("s", 0.0, 32.0**2),
        AreaRange("m", 32.0**2, 96.0**2),
        AreaRange("l", 96.0**2, 1e10),
    )
    """All first."""
