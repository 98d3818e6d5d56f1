"""What surfaces are made of, as light, infrared and radar waves see it."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """One kind of surface. Figures are typical of it, chosen by us within what is published."""

    name: str
    lidar: float
    """Diffuse reflectivity at 905 nm, 0 to 1, at normal incidence."""
    radar_db: float
    """Radar cross-section a square metre at 77 GHz and normal incidence [dB]."""
    radar_lobe_deg: float
    """Half width of the lobe in which radar waves come back: small for smooth metal, wide for leaves."""
    gloss: float = 0.0
    """Share of light that is mirrored at normal incidence, 0 to 1; more at grazing incidence (Schlick)."""
    retro: float = 0.0
    """Additional reflectivity for light that returns to its source: signs, plates, reflectors."""
    emits: float = 0.0
    """Luminance where it shines, in units of the camera's white by day; 0: shines never."""
    texture: str = "plain"
    """Name of its pattern in the camera: plain, asphalt, concrete, brick, grass, leaves, bark, cloth, tiles, soil."""


MATERIALS = (
    Material("asphalt", 0.17, -22.0, 60.0, texture="asphalt"),
    Material("marking", 0.55, -22.0, 60.0, retro=0.1, texture="plain"),
    Material("sidewalk", 0.32, -20.0, 60.0, texture="tiles"),
    Material("grass", 0.45, -16.0, 80.0, texture="grass"),
    Material("soil", 0.25, -18.0, 80.0, texture="soil"),
    Material("concrete", 0.35, -8.0, 40.0, texture="concrete"),
    Material("brick", 0.30, -8.0, 40.0, texture="brick"),
    Material("plaster", 0.50, -9.0, 40.0, texture="concrete"),
    Material("window", 0.08, -10.0, 15.0, gloss=0.08),
    Material("lit_window", 0.08, -10.0, 15.0, gloss=0.08, emits=0.0015),
    Material("roof", 0.25, -10.0, 40.0, texture="tiles"),
    Material("paint", 0.45, 3.0, 25.0, gloss=0.05),
    Material("glass", 0.06, -10.0, 15.0, gloss=0.08),
    Material("rubber", 0.06, -12.0, 60.0),
    Material("metal", 0.50, 5.0, 20.0, gloss=0.4),
    Material("plastic", 0.12, -10.0, 50.0, gloss=0.03),
    Material("headlight", 0.25, -2.0, 40.0, gloss=0.1, emits=6.0),
    Material("taillight", 0.30, -6.0, 40.0, gloss=0.06, retro=0.5, emits=0.6),
    Material("plate", 0.50, 0.0, 30.0, retro=0.8),
    Material("skin", 0.60, -5.0, 70.0),
    Material("cloth", 0.45, -7.0, 70.0, texture="cloth"),
    Material("foliage", 0.50, -12.0, 90.0, texture="leaves"),
    Material("bark", 0.35, -12.0, 70.0, texture="bark"),
    Material("sign", 0.40, 2.0, 20.0, retro=0.9),
    Material("pole", 0.35, 0.0, 30.0, gloss=0.05),
    Material("barrier", 0.40, 4.0, 25.0, gloss=0.08),
    Material("street_lamp", 0.30, 0.0, 40.0, emits=4.0),
    Material("signal_lamp", 0.20, -6.0, 40.0, emits=1.5),
    Material("wood", 0.45, -14.0, 60.0, texture="plain"),
)
INDEX: Mapping[str, int] = {material.name: i for i, material in enumerate(MATERIALS)}
"""Index into `MATERIALS` by name."""
