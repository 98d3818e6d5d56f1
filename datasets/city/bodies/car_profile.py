"""Hulls of cars by style: where bonnet, windscreen, roof and boot begin, drawn within usual sizes."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.profile import Profile

Range = tuple[float, float]


@dataclass(frozen=True)
class Style:
    """Ranges of sizes [m] and the shape as shares of the length."""

    length_m: Range
    width_m: Range
    height_m: Range
    cowl: float
    """Where the windscreen begins."""
    roof_from: float
    roof_to: float
    """Where the rear window begins."""
    deck: float
    """Where it ends."""
    boot: float
    """Height of the boot lid, or of the rear window's lower edge, as a share of the height."""
    doors: tuple[float, ...]
    """Where the side windows begin, are divided by pillars, and end."""
    axles: tuple[float, float]
    sill_m: float = 0.17
    wheel_m: float = 0.315


STYLES: Final = {
    "hatchback": Style((3.7, 4.3), (1.70, 1.80), (1.44, 1.53), 0.235, 0.42, 0.865, 0.98, 0.66,
                       (0.315, 0.525, 0.735, 0.83), (0.185, 0.815)),
    "sedan": Style((4.4, 4.9), (1.76, 1.86), (1.42, 1.48), 0.265, 0.42, 0.70, 0.855, 0.70,
                   (0.325, 0.505, 0.685, 0.775), (0.19, 0.79)),
    "estate": Style((4.4, 4.85), (1.76, 1.85), (1.45, 1.52), 0.255, 0.405, 0.925, 0.988, 0.65,
                    (0.315, 0.49, 0.675, 0.905), (0.19, 0.78)),
    "suv": Style((4.25, 4.75), (1.82, 1.90), (1.62, 1.74), 0.245, 0.39, 0.90, 0.985, 0.645,
                 (0.315, 0.50, 0.69, 0.87), (0.185, 0.80), 0.22, 0.355),
}  # fmt: skip
"""Sizes are typical of the European classes from supermini to large SUV."""


def car_profile(style: Style, draw: np.random.Generator) -> Profile:
    """Draw a car of a style."""
    length, width, height = (float(draw.uniform(*sizes)) for sizes in (style.length_m, style.width_m, style.height_m))
    belt, bonnet = 0.62 * height, (0.505 if style.sill_m < 0.2 else 0.54) * height
    cowl, roof, rear, deck = (share * length for share in (style.cowl, style.roof_from, style.roof_to, style.deck))
    boot = style.boot * height
    pairs = zip(style.doors[:-1], style.doors[1:], strict=True)
    return Profile(
        length_m=length, width_m=width,
        top=((0, bonnet), (0.07, bonnet + 0.06), (0.32, bonnet + 0.13),
             (cowl, belt + 0.1), (roof, height - 0.035),
             (0.55 * roof + 0.45 * rear, height), (rear, height - 0.05),
             (deck, boot + 0.02), (length - 0.05, boot),
             (length, boot - 0.07)),
        belt=((0, bonnet - 0.05), (0.25, bonnet + 0.02), (cowl, belt), (length, belt + 0.05)),
        plan=((0, 0.77), (0.06, 0.87), (0.17, 0.94), (0.45, 0.99), (0.7, 1), (length - 0.6, 1), (length - 0.3, 0.975),
              (length - 0.08, 0.92), (length, 0.84)),
        sill_m=style.sill_m, mid_m=(0.36 if style.sill_m < 0.2 else 0.29) * height, tumblehome=0.36,
        windscreen=(cowl + 0.03, roof - 0.02), rear_window=(rear + 0.05, deck - 0.04),
        windows=tuple((a * length + 0.04, b * length - 0.04) for a, b in pairs),
        axles=tuple(share * length for share in style.axles),
        wheel_radius_m=style.wheel_m * (0.97 + 0.06 * draw.random()),
    )  # fmt: skip
