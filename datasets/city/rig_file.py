"""Rigs from TOML, and single values of them from the command line."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from fbench.datasets.city.rig import WEATHER, CameraSpec, LidarSpec, RadarSpec, RigSpec
from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean
from fbench.replay.toml_file import TomlError, parse_toml

MAX_BYTES = 1024 * 1024
_TABLES: Mapping[str, type[BaseModel]] = {"cameras": CameraSpec, "lidars": LidarSpec, "radars": RadarSpec}


def read_rig(path: Path) -> RigSpec:
    """Return the rig that a TOML file describes: `[cameras.NAME]`, `[lidars.NAME]`, `[radars.NAME]`.

    Raises:
        ConfigError: where it can't be read, or naming the key that is wrong or unknown.
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
    """Return a rig with one value changed: `SENSOR.FIELD=VALUE`, the value as in TOML.

    Raises:
        ConfigError: naming what isn't there or doesn't fit.
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
    """Split `NAME.FIELD=VALUE`.

    Raises:
        ConfigError: where it isn't one.
    """
    path, equals, text = setting.partition("=")
    name, dot, field = path.strip().partition(".")
    if not (equals and dot and name and field and text.strip()):
        raise ConfigError(f"--set {setting}: expected NAME.FIELD=VALUE, such as lidar.channels=64")
    return name, field, text


def toml_value(setting: str, text: str) -> Any:
    """Return a value as TOML writes it: `1.5`, `true`, `[1.0, 0.0, 2.0]`.

    Raises:
        ConfigError: where it isn't one.
    """
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
