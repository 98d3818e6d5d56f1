"""Colors of road users and how often they are drawn, and the skins that many of them share."""

from typing import Final

import numpy as np

from fbench.datasets.city.mesh import Rgb, Skin, scale_color


def linear(code: str) -> Rgb:
    """Linear red, green and blue of an sRGB color such as "c81e1e" (IEC 61966-2-1)."""
    values = (int(code[i : i + 2], 16) / 255 for i in (0, 2, 4))
    r, g, b = (value / 12.92 if value <= 0.04045 else float(((value + 0.055) / 1.055) ** 2.4) for value in values)
    return r, g, b


CARS: Final = {
    "e9e9e6": 0.34, "16171a": 0.19, "6a6e72": 0.19, "b2b6ba": 0.09, "24457f": 0.08, "8f1a1c": 0.06,
    "4d3f33": 0.02, "31503f": 0.01, "c9551e": 0.01, "d8c9a4": 0.01,
}  # fmt: skip
"""sRGB of car paint and how often it is chosen: rounded from Axalta's Global Automotive Color Popularity Reports of
2020 and 2021 (white 35 %, black 19 %, gray 19 %, silver 9 %, blue 8 %)."""
VANS: Final = {"ecece8": 0.6, "b2b6ba": 0.1, "5b6065": 0.08, "1d1f22": 0.05, "24457f": 0.06, "a3191c": 0.05,
               "d9a514": 0.06}  # fmt: skip
LARGE: Final = {"e8e8e4": 0.35, "1f4287": 0.15, "a81d1d": 0.15, "d6881a": 0.08, "2c5a3a": 0.07, "8d9296": 0.12,
                "d9b21c": 0.08}  # fmt: skip
BUSES: Final = {"b01f24": 0.25, "e3b422": 0.2, "2456a0": 0.2, "e6e6e2": 0.15, "2f7d4f": 0.12, "d5701f": 0.08}
TOPS: Final = {"1c1e24": 0.22, "e6e4df": 0.12, "5c6167": 0.14, "27406e": 0.16, "8c2326": 0.08, "3f5c41": 0.07,
               "7a5a3c": 0.07, "b9a684": 0.06, "c9762a": 0.04, "5d8fb4": 0.04}  # fmt: skip
TROUSERS: Final = {"1b1d22": 0.32, "2b3a58": 0.36, "4a4d52": 0.14, "6f6149": 0.12, "9c9482": 0.06}
SKINS: Final = {"e8bd9c": 0.35, "d8a27c": 0.25, "b57d57": 0.18, "8a5a3b": 0.12, "583824": 0.1}
HAIR: Final = {"1a1512": 0.4, "3b2719": 0.3, "6b4a2b": 0.13, "b08d57": 0.08, "8b8a88": 0.09}
TYRE = Skin("rubber", linear("232425"))
BLACK = Skin("plastic", linear("1b1c1d"))
DARK = Skin("plastic", linear("2b2c2e"))
LINE = Skin("plastic", linear("101112"))
GLASS = Skin("glass", linear("1a2024"))
CHROME = Skin("metal", linear("b9bdc1"))
STEEL = Skin("metal", linear("85898d"))
PLATE = Skin("plate", linear("e8e8e2"))
_SPREAD: Final = 0.12  # How much lighter or darker a thing may be than its color in a table


def pick(draw: np.random.Generator, shares: dict[str, float]) -> Rgb:
    """Draw a color by its share, a little lighter or darker than in the table."""
    codes, weights = list(shares), np.array(list(shares.values()))
    bounds = np.cumsum(weights / weights.sum())
    code = codes[min(int(np.searchsorted(bounds, draw.random(), side="right")), len(codes) - 1)]
    return scale_color(linear(code), 1 + _SPREAD * (2 * draw.random() - 1))
