"""Conditions: what disturbs the messages of a log while it plays, and what is known at the place of a message."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np

from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Kind, Rig

Measurement: TypeAlias = Image | PointCloud | RadarScan
Level: TypeAlias = Mapping[str, float]
"""Numbers that say how strong a condition is, by name with unit."""
Need: TypeAlias = Literal["ring", "intensity", "time", "velocity", "rcs", "cloud", "truth", "calibration"]
"""What a message or log must have: a cloud's fields `ring`, `intensity` and `time` of each point, a scan's `velocity`
and `rcs`; a LiDAR's `cloud` beside an image; 3D `truth` in body coordinates; the `calibration` of a camera."""
NUM_LEVELS = 5
MAX_HISTORY = 8


@dataclass(frozen=True, eq=False)
class Site:
    """Where and when a message was measured, and random numbers for it."""

    key: tuple[str | int, ...]
    """Seed, condition@version, strength, log id and sensor: what random numbers depend on, beside their scope."""
    rig: Rig
    """As recorded."""
    sensor: str
    kind: Kind
    first_ns: int
    """Log time of the log's first message."""
    last_ns: int
    period_ns: int = 100_000_000
    """Median time between the sensor's messages."""
    history: Sequence[Measurement] = ()
    """Up to 8 earlier messages of the sensor since the rig changed, as recorded, the latest last."""
    cloud: PointCloud | None = None
    """For images: the latest LiDAR cloud that arrived before or with it, as recorded, at most 0.3 s away; of several
    LiDARs the largest."""
    truth: Boxes3D | None = None
    """In body coordinates, nearest in time and at most 50 ms away; for conditions that need it."""

    def rng(self, *scope: str | int) -> np.random.Generator:
        """Return the generator of what persists for the whole log: dead beams, dirt on a lens, an error of mounting."""
        seed, *rest = self.key
        return generator(int(seed), *rest, *scope)

    def rng_of_log(self, *scope: str | int) -> np.random.Generator:
        """Return the generator of what all sensors share: which of them fails, where the wind comes from."""
        seed, *rest = self.key[:-1]
        return generator(int(seed), *rest, *scope)

    def rng_of_place(self, *scope: str | int) -> np.random.Generator:
        """Return the generator of what persists for the whole log and is the same at every severity, so that more of it
        is more of the same: where the sun stands, where dirt lies.
        """
        seed, condition, *rest = self.key
        return generator(int(seed), str(condition).rpartition(":")[0], *rest, *scope)

    def rng_of(self, message: Measurement, *scope: str | int) -> np.random.Generator:
        """Return the generator of what is drawn anew for every message: it depends on no other message."""
        return self.rng(message.stamp_ns, message.log_ns, *scope)


class Condition(Protocol):
    """A seeded disturbance of the messages of sensors. Made without arguments; the docstring gives the formula and its
    source, for `fbench plugins conditions NAME`.
    """

    version: ClassVar[int]
    """Rises whenever the same message would become another one."""
    kinds: ClassVar[Sequence[Kind]]
    """Of the sensors whose messages it disturbs."""
    levels: ClassVar[Mapping[str, Sequence[float]]]
    """Five numbers each, for severities 1 to 5, by name with unit: `{"visibility_m": (600, 300, 150, 100, 50)}`. A
    value such as `150m` on the command line replaces the first one."""

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return what becomes of a message of one of `kinds`: nothing where it is lost, several where it is repeated.
        It is a function of the arguments alone, and changes none of them. Stamps may change, times of delivery
        (`log_ns`) only to later ones.
        """


@runtime_checkable
class ChangesTimes(Protocol):
    """A condition that drops, delays, repeats or restamps messages. Frames keep the instants that were recorded."""

    changes_times: ClassVar[bool]


@runtime_checkable
class HasNeeds(Protocol):
    """A condition that not every log allows."""

    needs: ClassVar[Sequence[Need]]


@runtime_checkable
class DisturbsRig(Protocol):
    """A condition that gives pipelines another calibration than that which holds."""

    def disturb_rig(self, rig: Rig, level: Level, site: Site) -> Rig:
        """Return the rig with another mount or camera model of `site.sensor`."""


@runtime_checkable
class MakesWeather(Protocol):
    """A condition that is weather: it disturbs all sensors by one state of the air, with other weathers together."""

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""


def needs_of(condition: Condition) -> Sequence[Need]:
    """Return what a condition needs."""
    return condition.needs if isinstance(condition, HasNeeds) else ()


@dataclass(frozen=True, eq=False)
class Part:
    """One condition with how strong it is, on which sensors and when."""

    name: str
    condition: Condition
    strength: str = "3"
    """Severity `1` to `5`, or the value that was given: `150m`."""
    level: Level = field(default_factory=dict)
    sensors: str = ""
    """Kind, name or pattern of the sensors; empty: all of the condition's kinds."""
    from_ns: int | None = None
    """After the log's first message, in log time; the window is half-open."""
    to_ns: int | None = None

    @property
    def id(self) -> str:
        """The condition with its version, and how strong it is."""
        return f"{self.name}@{self.condition.version}:{self.strength}"

    def __str__(self) -> str:
        scope = f".{self.sensors}" if self.sensors else ""
        begin, end = ("" if ns is None else f"{ns / 1e9:g}s" for ns in (self.from_ns, self.to_ns))
        window = f" ({begin}-{end})" if begin or end else ""  # with an @, errors would take it for a password
        return f"{self.name}{scope}:{self.strength}{window}"


def require_levels(name: str, condition: Condition) -> None:
    """Refuse levels that aren't five numbers each. Raises ConfigError naming them."""
    levels: object = condition.levels
    if not isinstance(levels, Mapping):
        raise ConfigError(f"condition '{name}': levels: expected five numbers by name, got {type(levels).__name__}")
    for key, values in levels.items():
        if len(values) != NUM_LEVELS or not np.isfinite(np.asarray(values, np.float64)).all():
            raise ConfigError(f"condition '{name}': levels: '{key}': expected {NUM_LEVELS} numbers, got {values!r}")
