"""Specification of a simulated log: nothing else decides a byte of it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from hashlib import blake2b
from typing import Literal, TypeAlias, get_args

import numpy as np

from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.replay.conditions.weather import Weather, combine
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.metadata import REFERENCE, SIMULATED


@dataclass(frozen=True)
class Condition:
    """Under which circumstances a scene is recorded."""

    name: str
    weather: Weather
    is_dense: bool = False  # Whether there is much traffic; it is another scene then


_OVERCAST_LUX = 8_000.0
CONDITIONS: Mapping[str, Condition] = {
    condition.name: condition
    for condition in (
        Condition("clear", Weather()),
        Condition("traffic", Weather(), is_dense=True),
        Condition("rain", Weather(visibility_m=8_000.0, rain_mm_h=15.0, lux=_OVERCAST_LUX)),
        Condition("heavy-rain", Weather(visibility_m=4_000.0, rain_mm_h=50.0, lux=4_000.0)),
        Condition("fog", Weather(visibility_m=100.0, lux=6_000.0)),
        Condition("dense-fog", Weather(visibility_m=50.0, lux=5_000.0)),
        Condition("night", Weather(lux=0.3, sun_elevation_deg=-30.0)),
        Condition("dusk", Weather(lux=150.0, sun_elevation_deg=-3.0)),
        Condition("low-sun", Weather(lux=10_000.0, sun_elevation_deg=6.0, sun_azimuth_deg=15.0)),
        Condition("overcast", Weather(visibility_m=15_000.0, lux=_OVERCAST_LUX)),
    )
}
"""By name. Visibilities in fog are the two densest levels of Dong et al. (CVPR 2023), rain rates those of heavy and
violent showers, illuminances those of the sky that the name says; the rest is chosen.
"""


def condition(text: str) -> Condition:
    """Return the condition of a name, or the mixture of several joined by `+`, such as `traffic+fog`. A mixture has the
    shortest visibility, the most rain, the least light, the lowest sun, and dense traffic where any of its parts has.
    Raises ConfigError for an unknown name, or one that comes twice.
    """
    names = [name.strip() for name in text.split("+")]
    for name in names:
        if name not in CONDITIONS:
            raise ConfigError(f"--condition {text}: no condition '{name}'{did_you_mean(name, CONDITIONS)}")
        if names.count(name) > 1:
            raise ConfigError(f"--condition {text}: '{name}' comes twice")
    parts = [CONDITIONS[name] for name in names]
    weather = combine([part.weather for part in parts])
    return Condition("+".join(names), weather, any(part.is_dense for part in parts))


WorldName: TypeAlias = Literal["urban", "highway"]
WORLDS: Mapping[str, WorldName] = {name: name for name in get_args(WorldName)}
VERSION = 2  # Of the simulation: rises whenever the same spec gives other messages
MAX_SEED = 2**63 - 1
MAX_SECONDS = 86_400.0


@dataclass(frozen=True)
class CitySpec:
    """One log. Raises ConfigError where a number is out of range, or the rig has no sensor."""

    world: WorldName = "urban"
    condition: Condition = field(default_factory=lambda: CONDITIONS["clear"])
    seconds: float = 10.0
    seed: int = 0
    rig: RigSpec = field(default_factory=thesis_rig)
    truth_range_m: float = 120.0  # Road users within this distance of the ego vehicle are in the truth

    def __post_init__(self) -> None:
        if not 0.1 <= self.seconds <= MAX_SECONDS:
            raise ConfigError(f"--seconds {self.seconds:g}: expected 0.1 to {MAX_SECONDS:g}")
        if not 0 <= self.seed <= MAX_SEED:
            raise ConfigError(f"--seed {self.seed}: expected 0 to 2^63 - 1")
        if not 0 < self.truth_range_m <= 1000:
            raise ConfigError(f"truth range of {self.truth_range_m:g} m: expected up to 1000")
        if not self.rig.names:
            raise ConfigError("the rig has no sensor")
        first_ms = self.rig.specs[self.rig.reference].phase_ms
        if first_ms >= 1000 * self.seconds:
            raise ConfigError(f"'{self.rig.reference}' measures first after {first_ms:g} ms, when the log has ended")

    @property
    def log_id(self) -> str:
        """Equal specs give equal ids."""
        lengths = f"{float(self.seconds)!r} {self.seed} {float(self.truth_range_m)!r}"
        rig = json.dumps(self.rig.model_dump(mode="json"), sort_keys=True)  # in a file, sensors come in any order
        digest = blake2b(f"{VERSION} {self.world} {lengths} {self.condition!r} {rig}".encode(), digest_size=8)
        return f"city-{digest.hexdigest()}"

    @property
    def metadata(self) -> dict[str, str]:
        """What the log says of its making."""
        shown = [f.name for f in fields(Weather) if f.repr]
        weather, lidars = self.condition.weather, sorted(self.rig.lidars.items())
        return {
            "dataset": "fbench city (simulated)",
            "licence": "made by fbench; free of rights",
            SIMULATED: str(VERSION),
            "scenario": self.world,
            "condition": self.condition.name,
            "traffic": "dense" if self.condition.is_dense else "normal",
            "seed": str(self.seed),
            REFERENCE: self.rig.reference,
            "stamps": "when measured; a LiDAR's when its turn ends",
            **{f"weather.{n}": np.format_float_positional(getattr(weather, n), trim="-") for n in shown},
            **{f"lidar.{name}.motion": "in the sweep" if s.motion else "frozen at the stamp" for name, s in lidars},
        }


def world_name(text: str) -> WorldName:
    """Return the world of a name. Raises ConfigError where there is none, with the nearest one."""
    if text not in WORLDS:
        raise ConfigError(f"no simulated world '{text}'{did_you_mean(text, WORLDS)}")
    return WORLDS[text]
