"""Parameters of single sensors, and the choice of the sensors that a pipeline gets."""

from collections.abc import Collection, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from typing import Any, Protocol, TypeVar

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.contracts.settings import parameter_paths, set_parameter
from fbench.replay.data.rig import KINDS, Kind, Rig

P = TypeVar("P")
_WORDS: dict[Kind, tuple[str, str]] = {
    "camera": ("a camera", "cameras"), "lidar": ("a LiDAR", "LiDARs"), "radar": ("a radar", "radars"),
}  # fmt: skip


class HasSensorSettings(Protocol):
    """Parameters of a pipeline: a dataclass, whose fields `camera`, `lidar` and `radar` hold those of a kind."""

    @property
    def by_sensor(self) -> tuple[str, ...]:
        """Settings `SENSOR.field=value`."""
        ...


class SensorSettings:
    """The settings by sensor of one pipeline on one rig, which doesn't use the kinds `unused` though it has parameters
    for them. Raises ConfigError where a setting names no sensor (with the nearest name), or one that isn't used.
    """

    def __init__(self, params: HasSensorSettings, rig: Rig, unused: Collection[Kind] = ()) -> None:
        self._params, self._rig, self._unused = params, rig, unused
        self._settings = [(self._sensor(setting), setting) for setting in params.by_sensor]

    def own(self, kind: Kind, params: P, differing: Sequence[str] | None = None) -> dict[str, P]:
        """Parameters of each sensor of one kind, by name: `params`, those of the kind, changed by what is set for that
        sensor. Only the parameters in `differing`, and groups of them, may differ between sensors; `None`: all may.
        Raises ConfigError for an unknown parameter, a wrong value, or one that must be the same for all.
        """
        own = dict.fromkeys(self._rig.sensors(kind), params)
        for sensor, setting in self._settings:
            if sensor in own:
                own[sensor] = _change(own[sensor], kind, sensor, setting, differing)
        return own

    def _sensor(self, setting: str) -> str:
        path = setting.partition("=")[0]
        named = [name for name in self._rig.mounts if path.startswith(f"{name}.")]
        if not named:
            raise ConfigError(f"--set {setting}: no such sensor or parameter{self._hint(path)}")
        sensor = max(named, key=len)
        kind = self._rig.mounts[sensor].kind
        if kind not in self._kinds:
            raise ConfigError(f"--set {setting}: '{sensor}' is {_WORDS[kind][0]}, and the pipeline has no use for it")
        return sensor

    @property
    def _kinds(self) -> dict[Kind, Any]:
        named = [f.name for f in fields(self._params)]  # type: ignore[arg-type]
        return {
            kind: getattr(self._params, kind) for kind in KINDS.values() if kind in named and kind not in self._unused
        }

    def _hint(self, path: str) -> str:
        sensors = self._rig.sensors(*self._kinds)
        known = [f"{name}.{p}" for name in sensors for p in parameter_paths(self._kinds[self._rig.mounts[name].kind])]
        hint = did_you_mean(path, [*known, *parameter_paths(self._params)])
        return hint if "did you mean" in hint else f"; sensors are: {', '.join(sensors)}"


def _change(params: P, kind: Kind, sensor: str, setting: str, differing: Sequence[str] | None) -> P:
    path, _, text = setting.partition("=")
    name = path[len(sensor) + 1 :]
    is_common = differing is not None and not any(name == d or name.startswith(f"{d}.") for d in differing)
    if is_common and name in parameter_paths(params):
        raise ConfigError(f"--set {setting}: it is common to all {_WORDS[kind][1]}, set {kind}.{name}")
    try:
        return set_parameter(params, path, name.split("."), text)
    except ConfigError as error:
        raise error if path in str(error) else ConfigError(f"--set {setting}: {error}") from error


def make_sensors(texts: Sequence[str]) -> list[str]:
    """Read `--sensors`: patterns, several of them with commas between. Raises ConfigError where one is empty."""
    patterns = [part.strip() for text in texts for part in text.split(",")]
    if any(not pattern.removeprefix("!") for pattern in patterns):
        raise ConfigError("--sensors: a pattern is empty, expected names such as front* or !radar")
    return patterns


def choose_sensors(names: Collection[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """Return those of the sensors, sorted, whose name fits a pattern (`*`, `?`, `[...]`); `!` before a pattern leaves
    out what fits it. Without patterns all are chosen. Raises ConfigError where a pattern fits no sensor, or nothing is
    left.
    """
    for pattern in patterns:
        if not any(_fits(name, pattern.removeprefix("!")) for name in names):
            hint = did_you_mean(pattern.removeprefix("!"), names)
            raise ConfigError(f"--sensors {pattern}: fits no sensor{hint}", "CFG001")
    wanted = [p for p in patterns if not p.startswith("!")] or ["*"]
    unwanted = [p[1:] for p in patterns if p.startswith("!")]
    chosen = tuple(
        name
        for name in sorted(names)
        if any(_fits(name, p) for p in wanted) and not any(_fits(name, p) for p in unwanted)
    )
    if patterns and not chosen:
        raise ConfigError(f"--sensors {','.join(patterns)}: leaves no sensor; there are: {', '.join(sorted(names))}")
    return chosen


def _fits(name: str, pattern: str) -> bool:
    return name == pattern or fnmatchcase(name, pattern)
