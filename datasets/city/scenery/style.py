"""What one building looks like, drawn from a seed."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from fbench.datasets.city.scenery.quads import shaded
from fbench.datasets.city.shapes import Rgb, Skin

Use: TypeAlias = Literal["house", "flats", "office", "hall"]

_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("brick", (0.25, 0.105, 0.07)), ("brick", (0.20, 0.085, 0.06)), ("brick", (0.32, 0.20, 0.13)),
    ("plaster", (0.62, 0.58, 0.50)), ("plaster", (0.55, 0.47, 0.34)), ("plaster", (0.50, 0.50, 0.49)),
    ("plaster", (0.50, 0.34, 0.26)), ("plaster", (0.42, 0.46, 0.47)), ("plaster", (0.66, 0.64, 0.60)),
    ("concrete", (0.36, 0.35, 0.33)),
)  # fmt: skip
_OFFICE_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("concrete", (0.36, 0.35, 0.34)), ("concrete", (0.45, 0.44, 0.42)), ("plaster", (0.58, 0.57, 0.55)),
    ("concrete", (0.22, 0.22, 0.23)), ("brick", (0.22, 0.10, 0.07)),
)  # fmt: skip
_HALL_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("concrete", (0.48, 0.49, 0.50)), ("concrete", (0.30, 0.34, 0.40)), ("plaster", (0.58, 0.57, 0.53)),
)  # fmt: skip
_ROOFS: tuple[Rgb, ...] = ((0.22, 0.09, 0.06), (0.15, 0.07, 0.05), (0.10, 0.10, 0.105), (0.16, 0.14, 0.13))
SHOP_COLORS: tuple[Rgb, ...] = (
    (0.35, 0.04, 0.04), (0.04, 0.10, 0.26), (0.04, 0.18, 0.09), (0.45, 0.26, 0.05), (0.06, 0.06, 0.065),
    (0.55, 0.53, 0.48), (0.10, 0.22, 0.24),
)  # fmt: skip
"""Of shops' name boards and awnings."""


@dataclass(frozen=True)
class Style:
    """How walls, windows and roof of one building are made."""

    use: Use
    wall: Skin
    base: Skin
    """The ground floor's walls."""
    trim: Skin
    """Cornices, sills, balconies."""
    frame: Skin
    roof: Skin
    storey_m: float
    ground_m: float
    """Height of the ground floor."""
    bay_m: float
    """About how far apart windows are."""
    window_share: float
    """A window's width, of its bay."""
    window_m: float
    """A window's height."""
    sill_m: float
    """Its height above the floor."""
    panes: int
    lit_share: float
    shop: bool
    awnings: bool
    balconies: bool
    pitched: bool

    @property
    def stands_out(self) -> bool:
        """Whether something stands far out of the front."""
        return self.awnings or self.balconies


def draw_style(size_lwh_m: tuple[float, float, float], rng: np.random.Generator) -> Style:
    """Draw how a building of a size looks."""
    use = _use(size_lwh_m, rng)
    palette = {"office": _OFFICE_WALLS, "hall": _HALL_WALLS}.get(use, _WALLS)
    material, color = palette[int(rng.integers(len(palette)))]
    wall = Skin(material, shaded(color, float(rng.uniform(0.85, 1.12))))
    pale = float(rng.uniform(0.45, 0.68))
    dark_frames = rng.random() < (0.7 if use == "office" else 0.35)
    shop = use in ("flats", "office") and bool(rng.random() < 0.6)
    awnings = shop and use == "flats" and bool(rng.random() < 0.6)
    ribbon = use == "office" and rng.random() < 0.6
    return Style(
        use=use,
        wall=wall,
        base=Skin("concrete", shaded(color, 0.7)) if rng.random() < 0.4 else wall,
        trim=Skin("concrete", (pale, pale, pale * 0.96)),
        frame=Skin("plastic", (0.045, 0.045, 0.05) if dark_frames else (0.66, 0.66, 0.64)),
        roof=Skin("roof", _ROOFS[int(rng.integers(len(_ROOFS)))]),
        storey_m=float(rng.uniform(3.0, 3.4)),
        ground_m=float(rng.uniform(3.9, 4.5)) if shop else 3.1,
        bay_m=float(rng.uniform(3.0, 3.8) if use == "office" else rng.uniform(2.5, 3.3)),
        window_share=0.94 if ribbon else float(rng.uniform(0.40, 0.55)),
        window_m=float(rng.uniform(1.7, 2.0) if ribbon else rng.uniform(1.4, 1.75)),
        sill_m=0.9,
        panes=int(rng.integers(1, 3)),
        lit_share=float(rng.uniform(0.1, 0.4)),
        shop=shop,
        awnings=awnings,
        balconies=use == "flats" and bool(rng.random() < 0.5),
        pitched=use == "house" or (use == "flats" and size_lwh_m[2] < 16 and bool(rng.random() < 0.4)),
    )


def _use(size_lwh_m: tuple[float, float, float], rng: np.random.Generator) -> Use:
    length, width, height = size_lwh_m
    if height < 14 and min(length, width) > 22:
        return "hall"
    if height < 9.5:
        return "house"
    return "office" if rng.random() < (0.75 if height > 21 else 0.25) else "flats"
