"""Parameters: nested frozen dataclasses, changed by `name.field=value`, described for the manifest."""

import hashlib
import math
import types
import typing
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.files import expand_user, is_file

P = TypeVar("P")
BY_SENSOR = "by_sensor"
"""Field of a pipeline's parameters, `tuple[str, ...]`, that collects settings `SENSOR.field=value`; only the rig tells
which sensors there are (`sensor_settings`).
"""


def apply_settings(params: P, settings: Sequence[str]) -> P:
    """Return a copy of `params` with each setting `name.field=value` applied. Where they have a field `by_sensor`, it
    collects the settings whose name begins with none of their fields. Raises ConfigError for a setting without `=`, an
    unknown name (with the nearest one), a value of another type.
    """
    for setting in settings:
        path, equals, text = setting.partition("=")
        if not equals:
            raise ConfigError(f"--set {setting}: expected NAME=VALUE, such as lidar.cluster.eps_m=0.6")
        if _may_name_sensor(params, path.split(".")):
            params = replace(params, **{BY_SENSOR: (*getattr(params, BY_SENSOR), setting)})  # type: ignore[type-var]
        else:
            params = set_parameter(params, path, path.split("."), text)
    return params


def _may_name_sensor(params: object, names: list[str]) -> bool:
    """Tell whether the first names are those of a sensor; it may be called as a field is, and have dots in its name."""
    if not has_sensor_settings(params) or len(names) < 2 or names[0] == BY_SENSOR:
        return False
    if names[0] not in typing.get_type_hints(type(params)):
        return True
    known = parameter_paths(getattr(params, names[0]))
    return ".".join(names[1:]) not in known and any(".".join(names[i:]) in known for i in range(2, len(names)))


def has_sensor_settings(params: object) -> bool:
    """Tell whether parameters can be set for single sensors."""
    return is_dataclass(params) and any(f.name == BY_SENSOR for f in fields(params))


def set_parameter(params: P, path: str, names: list[str], text: str) -> P:
    """Return a copy of `params` with the parameter of these names set; `path` is what errors call it. Raises
    ConfigError for an unknown name (with the nearest one), or a value of another type.
    """
    name, *rest = names
    known = typing.get_type_hints(type(params))
    if name not in known or name == BY_SENSOR:
        # The nearest name is looked for among full paths, so that a forgotten prefix is found as well.
        done = path.split(".")[: -len(names)]
        paths = [".".join([*done, p]) for p in parameter_paths(params)]
        raise ConfigError(f"unknown parameter '{path}'{did_you_mean(path, paths)}")
    value = getattr(params, name)
    if rest and is_dataclass(value):
        changed: object = set_parameter(value, path, rest, text)
    elif rest or is_dataclass(value):
        raise ConfigError(f"'{path}' isn't a single parameter{did_you_mean(path, parameter_paths(params))}")
    else:
        changed = _parse(path, known[name], text)
    return replace(params, **{name: changed})  # type: ignore[type-var]


def _parse(path: str, hint: Any, text: str) -> object:
    is_union = isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union
    options = typing.get_args(hint) if is_union else (hint,)
    if text == "none" and type(None) in options:
        return None
    for option in options:
        try:
            return _convert(option, text)
        except ValueError:
            continue
    *names, last = (name for option in options for name in _name_values(option))
    raise ConfigError(f"--set {path}={text}: expected {', '.join(names)}{' or ' if names else ''}{last}")


def _name_values(kind: Any) -> tuple[str, ...]:
    """Return the values of a kind where they are few, else its name."""
    if typing.get_origin(kind) is typing.Literal:
        return typing.get_args(kind)
    return ("none",) if kind is type(None) else (getattr(kind, "__name__", str(kind)),)


def _convert(kind: Any, text: str) -> object:
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(text)
        return text.lower() == "true"
    if typing.get_origin(kind) is typing.Literal:
        if text not in typing.get_args(kind):
            raise ValueError(text)
        return text
    if typing.get_origin(kind) is tuple:
        parts, kinds, is_open = text.split(","), typing.get_args(kind), Ellipsis in typing.get_args(kind)
        if not is_open and len(parts) != len(kinds):
            raise ValueError(text)
        return tuple(_convert(kinds[0 if is_open else i], part) for i, part in enumerate(parts))
    if kind is Path:
        return expand_user(text)
    if kind in (int, float, str):
        value: object = kind(text)
        if isinstance(value, float) and math.isnan(value):
            raise ValueError(text)
        return value
    raise ValueError(text)


def parameter_paths(params: object) -> list[str]:
    """Return the dotted names of all single parameters."""
    return [path for path, _ in _walk(params)]


def _walk(params: object) -> list[tuple[str, object]]:
    if not is_dataclass(params) or isinstance(params, type):
        return []
    rows: list[tuple[str, object]] = []
    for name in (f.name for f in fields(params) if f.name != BY_SENSOR):
        value = getattr(params, name)
        rows += [(f"{name}.{path}", v) for path, v in _walk(value)] if is_dataclass(value) else [(name, value)]
    return rows


def describe(params: object) -> dict[str, object]:
    """Return all parameters by dotted name, JSON-ready; a file becomes its name and sha256."""
    described = {path: _describe(value) for path, value in _walk(params)}
    for setting in getattr(params, BY_SENSOR) if has_sensor_settings(params) else ():
        path, _, text = setting.partition("=")
        described[path] = _describe(expand_user(text)) if names_file(params, path, text) else text
    return described


def describe_file(path: Path) -> dict[str, object]:
    """Return a file's name and sha256, `None` where it can't be read, as a program may be."""
    try:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    except PermissionError:
        sha256 = None
    return {"file": path.name, "sha256": sha256}


def names_file(params: object, path: str, text: str) -> bool:
    """Tell whether what a parameter is set to, whose dotted name may begin with that of a sensor, is a file."""
    name = path.rpartition(".")[2]
    cls: Any = type(params)  # mypy takes no `type[object]` for a key
    hints = [hint for known, hint in _hints(cls) if known == name]
    may_be = [hint for hint in hints if Path in (hint, *typing.get_args(hint))]
    # A text that one of these types takes as a word of its own, such as `none`, is that word.
    return bool(may_be) and all(isinstance(_parse("", hint, text), Path) for hint in may_be)


@lru_cache(64)
def _hints(cls: type) -> Sequence[tuple[str, Any]]:
    """Names and types of all single parameters of a class, without what precedes them."""
    rows: list[tuple[str, Any]] = []
    for name, hint in typing.get_type_hints(cls).items():
        rows += _hints(hint) if is_dataclass(hint) and isinstance(hint, type) else [(name, hint)]
    return rows


def _describe(value: object) -> object:
    if isinstance(value, Path):
        if not is_file(value):
            raise ConfigError(f"{value}: no such file")
        return describe_file(value)
    if isinstance(value, tuple):
        return [_describe(item) for item in value]
    plain = value is None or isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value))
    return value if plain else str(value)
