"""A simulation as the command line asks for it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from fbench.datasets.city.conditions import Condition, condition
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.rig_file import read_rig, split_setting, toml_value, with_value
from fbench.datasets.city.spec import CitySpec, world_name
from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean
from fbench.replay.sensor_choice import chosen_sensors, make_sensors
from fbench.replay.weather import Weather

_WEATHER = "weather"


@dataclass(frozen=True)
class CityWish:
    """Texts that say what to simulate."""

    world: str = "urban"
    condition: str = "clear"
    seconds: float = 10.0
    seed: int = 0
    rig_file: Path | None = None
    sensors: Sequence[str] = ()
    """Patterns of the sensors to simulate; all where there are none."""
    settings: Sequence[str] = ()
    """`SENSOR.FIELD=VALUE` and `weather.FIELD=VALUE`."""

    def spec(self) -> CitySpec:
        """Return what to simulate.

        Raises:
            ConfigError: naming what isn't there or doesn't fit.
        """
        under = condition(self.condition)
        rig = thesis_rig() if self.rig_file is None else read_rig(self.rig_file)
        for setting in self.settings:
            if split_setting(setting)[0] == _WEATHER:
                under = _with_weather(under, setting)
            else:
                rig = with_value(rig, setting)
        return CitySpec(world_name(self.world), under, self.seconds, self.seed, _chosen(rig, self.sensors))


def _with_weather(under: Condition, setting: str) -> Condition:
    _, field, text = split_setting(setting)
    names = [f.name for f in fields(Weather)]
    if field not in names:
        raise ConfigError(f"--set {setting}: no '{field}' in the weather{did_you_mean(field, names)}")
    value = toml_value(setting, text)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"--set {setting}: expected a number, got {text}")
    changed = {field: float(value)}
    return replace(under, weather=replace(under.weather, **changed))


def _chosen(rig: RigSpec, patterns: Sequence[str]) -> RigSpec:
    names = chosen_sensors(rig.names, make_sensors(patterns))
    return RigSpec(
        cameras={name: spec for name, spec in rig.cameras.items() if name in names},
        lidars={name: spec for name, spec in rig.lidars.items() if name in names},
        radars={name: spec for name, spec in rig.radars.items() if name in names},
        pose_rate_hz=rig.pose_rate_hz,
    )
