"""Requests for simulated logs from the command line, rigs from TOML, and the fixed suites."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import BaseModel, ValidationError

from fbench.datasets.city.rig import WEATHER, CameraSpec, LidarSpec, RadarSpec, RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, Condition, WorldName, condition, world_name
from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.contracts.sensor_settings import choose_sensors, make_sensors
from fbench.replay.formats.documents import TomlError, parse_toml

MAX_BYTES = 1024 * 1024
_TABLES: Mapping[str, type[BaseModel]] = {"cameras": CameraSpec, "lidars": LidarSpec, "radars": RadarSpec}


def read_rig(path: Path) -> RigSpec:
    """Return the rig that a TOML file describes: `[cameras.NAME]`, `[lidars.NAME]`, `[radars.NAME]`. Raises ConfigError
    where it can't be read, or naming the key that is wrong or unknown.
    """
    try:
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; expected a TOML file with the sensors")
        if not path.is_file():
            raise ConfigError(f"{path}: no such file")
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: over {MAX_BYTES} bytes, which no rig takes")
        tables = parse_toml(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror})") from error
    except TomlError as error:
        raise ConfigError(f"{path}: isn't TOML ({error})") from error
    return _valid(str(path), tables)


def with_value(rig: RigSpec, setting: str) -> RigSpec:
    """Return a rig with one value changed: `SENSOR.FIELD=VALUE`, the value as in TOML. Raises ConfigError naming what
    isn't there or doesn't fit.
    """
    name, field, text = split_setting(setting)
    tables = rig.model_dump()
    kind = next((kind for kind in _TABLES if name in tables[kind]), None)
    if kind is None:
        known = [*rig.names, WEATHER]
        raise ConfigError(f"--set {setting}: no sensor '{name}'{did_you_mean(name, known)}")
    tables[kind][name][field] = toml_value(setting, text)
    return _valid(f"--set {setting}", tables)


def split_setting(setting: str) -> tuple[str, str, str]:
    """Split `NAME.FIELD=VALUE`. Raises ConfigError where it isn't one."""
    path, equals, text = setting.partition("=")
    name, dot, field = path.strip().partition(".")
    if not (equals and dot and name and field and text.strip()):
        raise ConfigError(f"--set {setting}: expected NAME.FIELD=VALUE, such as lidar.channels=64")
    return name, field, text


def toml_value(setting: str, text: str) -> Any:
    """Return a value as TOML writes it: `1.5`, `true`, `[1.0, 0.0, 2.0]`. Raises ConfigError where it isn't one."""
    try:
        table = parse_toml(f"value = {text}".encode())
    except (TomlError, UnicodeEncodeError):
        raise ConfigError(f"--set {setting}: '{text}' isn't a value of TOML") from None
    if set(table) != {"value"}:
        raise ConfigError(f"--set {setting}: '{text}' isn't one value of TOML")
    return table["value"]


def _valid(where: str, tables: dict[str, Any]) -> RigSpec:
    try:
        rig = RigSpec.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(f"{where}: {_first(error)}") from None
    if not rig.names:
        raise ConfigError(f"{where}: no sensor in it; expected [cameras.NAME], [lidars.NAME] or [radars.NAME]")
    return rig


def _first(error: ValidationError) -> str:
    """What is wrong first, with the name that may be meant: a field that is missing may just be misspelt."""
    errors = error.errors(include_url=False)
    first = next((one for one in errors if one["type"] == "extra_forbidden"), errors[0])
    place = [str(part) for part in first["loc"] if part != "[key]"]
    if first["type"] == "extra_forbidden":
        model = RigSpec if len(place) < 3 else _TABLES[place[0]]
        return f"unknown key '{'.'.join(place)}'{did_you_mean(place[-1], model.model_fields)}"
    if first["type"] == "value_error":  # of several fields together
        return f"{'.'.join(place) or 'rig'}: {first['ctx']['error']}"
    if first["type"] == "missing":
        return f"{'.'.join(place)}: Field required"
    got = str(first["input"])
    shown = got if len(got) <= 60 else f"{got[:60]}..."
    return f"{'.'.join(place)}: {first['msg']}, got {shown}" if place else first["msg"]


@dataclass(frozen=True)
class CityRequest:
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
        """Return what to simulate. Raises ConfigError naming what isn't there or doesn't fit."""
        under = condition(self.condition)
        rig = thesis_rig() if self.rig_file is None else read_rig(self.rig_file)
        for setting in self.settings:
            if split_setting(setting)[0] == WEATHER:
                under = _with_weather(under, setting)
            else:
                rig = with_value(rig, setting)
        names = choose_sensors(rig.names, make_sensors(self.sensors))
        tables = {kind: {name: spec for name, spec in getattr(rig, kind).items() if name in names} for kind in _TABLES}
        rig = rig.model_copy(update=tables)
        return CitySpec(world_name(self.world), under, self.seconds, self.seed, rig)


def _with_weather(under: Condition, setting: str) -> Condition:
    _, field, text = split_setting(setting)
    names = [f.name for f in fields(Weather)]
    if field not in names:
        raise ConfigError(f"--set {setting}: no '{field}' in the weather{did_you_mean(field, names)}")
    value = toml_value(setting, text)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"--set {setting}: expected a number, got {text}")
    return replace(under, weather=replace(under.weather, **{field: float(value)}))


Split: TypeAlias = Literal["dev", "test"]
SEEDS: Mapping[Split, tuple[int, ...]] = {
    "dev": (101, 102, 103, 104, 105, 106, 107, 108),
    "test": (9001, 9002, 9003, 9004),
}
"""Seeds to develop, train and tune on, and those to report figures of. No pipeline may be tuned on the test seeds; they
never change.
"""
DEMO_SEEDS: Mapping[WorldName, tuple[int, ...]] = {"urban": (202, 212), "highway": (205,)}
"""Of the short version: those of 201 to 212 whose first 1.5 s show the most vehicles nearer than 50 m. Nothing was
trained or tuned on any of them.
"""


@dataclass(frozen=True)
class Scene:
    """One entry of the suite."""

    world: WorldName
    condition: str

    def name(self, seed: int) -> str:
        """Name of its log."""
        return f"{self.world}-{self.condition}-{seed}"


_BOTH: tuple[WorldName, ...] = ("urban", "highway")
SUITE: tuple[Scene, ...] = (
    *(Scene(world, name) for world in _BOTH for name in ("clear", "traffic", "rain", "fog", "night")),
    Scene("urban", "traffic+fog"), Scene("highway", "heavy-rain"),
)  # fmt: skip
"""One seed gives the same world in all of them, and the same trajectories wherever traffic is as dense: conditions are
compared on the same scene.
"""
TRAINING_SEEDS = range(301, 371)  # None of the suite's. Each is another drive: those teach more than other weathers do.
_WEATHERS = ("clear", "fog", "night", "rain", "low-sun", "dusk", "dense-fog", "heavy-rain", "overcast", "night")
"""One a drive, in turn; by night twice as many, as that is hardest."""
_SECONDS, _RATE_HZ = 16.0, 0.25  # Few images of many drives teach more than many of few


def training_logs() -> Iterator[tuple[str, CitySpec]]:
    """Yield name and spec of every log: four cameras like the thesis's mono camera look ahead, back and to the sides,
    beside a radar each, below the thesis's LiDAR; points are as dense as there in each message. Each drive comes with
    normal and with dense traffic.
    """
    views = {"front": ((2.0, 0.0, 1.0), 0.0), "rear": ((-2.0, 0.0, 1.2), 180.0),
             "left": ((0.5, 0.8, 1.4), 60.0), "right": ((0.5, -0.8, 1.6), -60.0)}  # fmt: skip
    cameras = {name: CameraSpec(translation_m=at, yaw_pitch_roll_deg=(yaw_deg, 0.0, 0.0), rate_hz=_RATE_HZ)
               for name, (at, yaw_deg) in views.items()}  # fmt: skip
    lidar, radar = _slow_down(_POINT_RATE_HZ)
    radar = radar.model_copy(
        update={"rate_hz": _RATE_HZ, "points_per_s": round(radar.points_per_s * _RATE_HZ / _POINT_RATE_HZ)}
    )
    radars = {
        f"{name}_radar": radar.model_copy(update={"translation_m": at, "yaw_pitch_roll_deg": (yaw_deg, -5.0, 0.0)})
        for name, (at, yaw_deg) in views.items()
    }
    rig = RigSpec(cameras=cameras, lidars={"lidar": lidar}, radars=radars, pose_rate_hz=1.0)
    for world in _BOTH:
        for place, seed in enumerate(TRAINING_SEEDS):
            for turn, traffic in enumerate(("", "traffic+")):
                weather = _WEATHERS[(place + 3 * turn) % len(_WEATHERS)]
                name = "traffic" if traffic and weather == "clear" else traffic + weather
                yield f"{world}-{name}-{seed}", CitySpec(world, condition(name), _SECONDS, seed, rig)


def _slow_down(rate_hz: float) -> tuple[LidarSpec, RadarSpec]:
    """LiDAR and radar of the thesis with as many points in each message, but fewer messages."""
    rig = thesis_rig()
    lidar, radar = rig.lidars["lidar"], rig.radars["radar"]
    few = [round(spec.points_per_s / spec.rate_hz * rate_hz) for spec in (lidar, radar)]
    return (
        lidar.model_copy(update={"rate_hz": rate_hz, "points_per_s": few[0]}),
        radar.model_copy(update={"rate_hz": rate_hz, "points_per_s": few[1]}),
    )


_POINT_WEATHERS = ("clear", "fog", "rain", "clear", "dense-fog", "heavy-rain", "clear")
_POINT_SECONDS, _POINT_RATE_HZ = 24.0, 0.5


def point_training_logs() -> Iterator[tuple[str, CitySpec]]:
    """Yield name and spec of every log of points: LiDAR and radar of the thesis, as dense as there in each message but
    one every 2 s; each drive with normal and with dense traffic.
    """
    lidar, radar = _slow_down(_POINT_RATE_HZ)
    rig = RigSpec(lidars={"lidar": lidar}, radars={"radar": radar}, pose_rate_hz=1.0)
    for world in _BOTH:
        for place, seed in enumerate(TRAINING_SEEDS):
            for turn, traffic in enumerate(("", "traffic+")):
                weather = _POINT_WEATHERS[(place + 3 * turn) % len(_POINT_WEATHERS)]
                name = "traffic" if traffic and weather == "clear" else traffic + weather
                yield f"{world}-{name}-{seed}", CitySpec(world, condition(name), _POINT_SECONDS, seed, rig)
