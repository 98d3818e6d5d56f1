"""What a simulated log is made from: nothing else decides a byte of it."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from hashlib import blake2b
from typing import Literal, TypeAlias, get_args

import numpy as np

from fbench.datasets.city.conditions import CONDITIONS, Condition
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.replay.errors import ConfigError
from fbench.replay.log_keys import REFERENCE, SIMULATED
from fbench.replay.names import did_you_mean

WorldName: TypeAlias = Literal["urban", "highway"]
WORLDS: Mapping[str, WorldName] = {name: name for name in get_args(WorldName)}
VERSION = 2
"""Of the simulation: rises whenever the same spec gives other messages."""
MAX_SEED = 2**63 - 1
MAX_SECONDS = 86_400.0


@dataclass(frozen=True)
class CitySpec:
    """One log.

    Raises:
        ConfigError: where a number is out of range, or the rig has no sensor.
    """

    world: WorldName = "urban"
    condition: Condition = field(default_factory=lambda: CONDITIONS["clear"])
    seconds: float = 10.0
    seed: int = 0
    rig: RigSpec = field(default_factory=thesis_rig)
    truth_range_m: float = 120.0
    """Road users within this distance of the ego vehicle are in the truth."""

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
        weather = {f"weather.{name}": _shortest(value) for name, value in asdict(self.condition.weather).items()}
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
            **weather,
            **{f"lidar.{name}.motion": _motion(spec.motion) for name, spec in sorted(self.rig.lidars.items())},
        }


def _shortest(value: float) -> str:
    """All digits that tell a number from its neighbours, and no more."""
    return np.format_float_positional(value, trim="-")


def _motion(is_in_sweep: bool) -> str:
    return "in the sweep" if is_in_sweep else "frozen at the stamp"


def world_name(text: str) -> WorldName:
    """Return the world of a name.

    Raises:
        ConfigError: where there is none, with the nearest one.
    """
    if text not in WORLDS:
        raise ConfigError(f"no simulated world '{text}'{did_you_mean(text, WORLDS)}")
    return WORLDS[text]
