"""How much traffic there is, and who takes part."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from fbench.datasets.city.spec import WorldName
from fbench.replay.errors import ConfigError

URBAN_MIX: Mapping[str, float] = MappingProxyType(
    {"car": 0.78, "van": 0.1, "truck": 0.04, "bus": 0.04, "motorcycle": 0.04}
)
HIGHWAY_MIX: Mapping[str, float] = MappingProxyType(
    {"car": 0.72, "van": 0.09, "truck": 0.14, "bus": 0.02, "motorcycle": 0.03}
)
"""Shares of moving vehicles: passenger cars dominate, on motorways one vehicle in seven is a truck."""


@dataclass(frozen=True)
class TrafficParams:
    """Densities and kinds.

    Raises:
        ConfigError: where a number is negative or above 1000, or a share above 1.
    """

    vehicles_per_km: float = 16.0
    """Moving motor vehicles on each km of drive lane outside junctions."""
    bicycles_per_km: float = 7.0
    """On each km of bike lane."""
    pedestrians_per_km: float = 5.5
    """On each km of walk lane."""
    parked_share: float = 0.2
    """Of places to park."""
    mix: Mapping[str, float] = field(default_factory=lambda: URBAN_MIX)
    """How often a moving vehicle is of which kind."""
    longest_m: float = 12.2
    """Longer bodies are drawn anew."""
    speed_spread: float = 0.08
    """Standard deviation of the drivers' factor on speed limits."""

    def __post_init__(self) -> None:
        for name in ("vehicles_per_km", "bicycles_per_km", "pedestrians_per_km", "parked_share", "speed_spread"):
            value, most = getattr(self, name), 1 if name == "parked_share" else 1000
            if not 0 <= value <= most:
                raise ConfigError(f"traffic {name}: expected 0 to {most}, got {value}")

    @classmethod
    def of(cls, world: WorldName, density: Literal["normal", "dense"] = "normal") -> "TrafficParams":
        """Typical traffic of a world."""
        dense = density == "dense"
        if world == "highway":
            return cls(14.0 if dense else 7.0, mix=HIGHWAY_MIX, longest_m=20.0, speed_spread=0.1)
        return cls(29.0, 14.0, 11.0, 0.3) if dense else cls()
