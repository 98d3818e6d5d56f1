"""Conditions as texts: `fog:3`, `rain:25mmh+night`, `dropout.radar:2@5s-8s`, or a TOML file."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fbench.replay.contracts.conditions import NUM_LEVELS, Condition, MakesWeather, Part, require_levels
from fbench.replay.contracts.entry_points import entry_points_of
from fbench.replay.contracts.errors import ConfigError, did_you_mean, first_wrong
from fbench.replay.contracts.plugins import guard, make_condition
from fbench.replay.data.rig import KINDS
from fbench.replay.formats.documents import TomlError, parse_toml

CLEAR = "clear"
_DEFAULT = "3"
_FILE, _SUFFIX = ".py:", ".toml"
_WINDOW = re.compile(r"@(?:(?P<begin>\d+(?:\.\d+)?)s)?-(?:(?P<end>\d+(?:\.\d+)?)s)?$")
_STRENGTH = re.compile(r":(?P<number>\d+(?:\.\d+)?)(?P<unit>[a-z%]*)$")
_UNITS: Mapping[str, str] = {
    "m": "_m", "mmh": "_mm_h", "mm": "_mm", "lux": "lux", "s": "_s", "ms": "_ms", "deg": "_deg", "db": "_db",
    "px": "_px", "ppm": "_ppm", "%": "share",
}  # fmt: skip
"""How the name of a level's number ends, by the unit in which it is written."""
_MAX_BYTES = 1024 * 1024


def parse_conditions(text: str) -> tuple[Part, ...]:
    """Return the parts of `NAME[.SENSORS][:STRENGTH][@FROM-TO]`, joined by `+`, or of a TOML file; those of severity 0
    and `clear` are none. Raises ConfigError where a part can't be understood, with the nearest name.
    """
    if not text:
        return ()
    if text.endswith(_SUFFIX):
        return _read_file(Path(text))
    parts = [_parse(part.strip(), text) for part in text.split("+")]
    return tuple(part for part in parts if part is not None)


def has_strength(text: str) -> bool:
    """Tell whether a condition says how strong it is, in any of its parts, or is a file that does."""
    return text.endswith(_SUFFIX) or any(_STRENGTH.search(_WINDOW.sub("", part.strip())) for part in text.split("+"))


def with_absolute_files(text: str) -> str:
    """Return what `parse_conditions` takes as seen from any folder."""
    if text.endswith(_SUFFIX):
        return str(Path(text).resolve())
    parts = (part.strip().rpartition(_FILE) for part in text.split("+"))
    return "+".join(f"{Path(path + '.py').resolve()}:{rest}" if path else rest for path, _, rest in parts)


def _parse(text: str, whole: str) -> Part | None:
    where, shown = (name.replace("@", " @") for name in (f"--condition {whole}", text))  # else taken for a password
    head, from_ns, to_ns = text, None, None
    if "@" in text:
        window = _WINDOW.search(text)
        if window is None or window.group() == "@-":
            raise ConfigError(f"{where}: '{shown}': expected a window such as @5s-8s after '@'")
        head = text[: window.start()]
        from_ns, to_ns = (
            None if seconds is None else round(float(seconds) * 1e9) for seconds in window.group("begin", "end")
        )
    found = _STRENGTH.search(head)
    name, strength = (head, _DEFAULT) if found is None else (head[: found.start()], found.group()[1:])
    if found is None and ":" in head and _FILE not in head:
        raise ConfigError(f"{where}: '{text}': expected a severity of 0 to {NUM_LEVELS}, or a value such as 150m")
    return _make(where, name, strength, "", from_ns, to_ns)


def _make(where: str, text: str, strength: str, sensors: str, from_ns: int | None, to_ns: int | None) -> Part | None:
    if from_ns is not None and to_ns is not None and to_ns <= from_ns:
        raise ConfigError(f"{where}: the window begins at {from_ns / 1e9:g} s, so it can't end at {to_ns / 1e9:g} s")
    if text == CLEAR:
        return None
    name, scope = split_name(text, f"{where}: ")
    if scope and sensors:
        raise ConfigError(f"{where}: '{text}' names sensors already")
    condition = load_condition(name)
    if strength.isascii() and strength.isdecimal():
        strength = str(int(strength))  # random numbers depend on it
    level = make_level(where, name, condition, strength)
    if level is not None and isinstance(condition, MakesWeather):
        try:
            with guard(f"{where}: condition '{name}' has no weather"):
                condition.weather(level)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from error
    label = Path(name).name if _FILE in name else name  # random numbers don't depend on where a file lies
    return None if level is None else Part(label, condition, strength, level, scope or sensors, from_ns, to_ns)


def split_name(text: str, where: str = "") -> tuple[str, str]:
    """Return the name of a condition and what names sensors in `lidar.fog`, `dropout.radar` or `lidar.fog.lidar_top`.
    Raises ConfigError, beginning with `where`, for an unknown name, with the nearest one.
    """
    if _FILE in text:
        path, _, member = text.rpartition(_FILE)
        class_name, _, scope = member.partition(".")
        return f"{path}{_FILE}{class_name}", scope
    names = entry_points_of("conditions")
    kind, _, rest = text.partition(".")
    pairs = [(text, "")] + ([(rest, kind)] if kind in KINDS else [])
    for whole, prefix in pairs:
        words = whole.split(".")
        for num in range(len(words), 0, -1):
            name = ".".join(words[:num])
            if name in names:
                return name, ".".join(words[num:]) or prefix
    known = [*names, *(f"{kind}.{name}" for name in names if "." not in name)] if kind in KINDS else names
    raise ConfigError(f"{where}unknown condition '{text}'{did_you_mean(text, known)}")


def load_condition(name: str) -> Condition:
    """Make the condition of an entry point, or that of `FILE.py:CLASS`. Raises ConfigError where it can't be made, or
    isn't one.
    """
    condition = make_condition(name)
    require_levels(name, condition)
    return condition


def make_level(where: str, name: str, condition: Condition, strength: str) -> dict[str, float] | None:
    """Return the numbers of a severity, or those of 3 with the first one replaced by a value such as `150m`; `None` for
    severity 0. Raises ConfigError where it is neither.
    """
    levels = condition.levels
    if strength.isascii() and strength.isdecimal():
        severity = int(strength)
        if severity > NUM_LEVELS:
            raise ConfigError(f"{where}: '{name}:{strength}': expected a severity of 0 to {NUM_LEVELS}")
        return None if severity == 0 else {key: float(values[severity - 1]) for key, values in levels.items()}
    found = _STRENGTH.fullmatch(f":{strength}")
    first = next(iter(levels), "")
    ending = None if found is None else _UNITS.get(found["unit"])
    if found is None or ending is None or not first.endswith(ending):
        unit = next((unit for unit, end in reversed([*_UNITS.items()]) if first.endswith(end)), "")
        hint = f", or a value such as {levels[first][2] * (100 if unit == '%' else 1):g}{unit}" if unit else ""
        raise ConfigError(f"{where}: '{name}:{strength}': expected a severity of 0 to {NUM_LEVELS}{hint}")
    value = float(found["number"]) / (100 if found["unit"] == "%" else 1)
    if found["unit"] == "%" and value > 1:
        raise ConfigError(f"{where}: '{name}:{strength}': expected at most 100%")
    return {**{key: float(values[2]) for key, values in levels.items()}, first: value}


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    name: str
    severity: Annotated[int, Field(ge=0, le=NUM_LEVELS)] | None = None
    value: str | None = None
    sensors: str = ""
    from_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    to_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    version: Literal[1]
    conditions: list[_Entry]


def _read_file(path: Path) -> tuple[Part, ...]:
    where = f"--condition {path}"
    try:
        if not path.is_file():
            raise ConfigError(f"{where}: no such file")
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"{where}: over {_MAX_BYTES} bytes, which no conditions take")
        file = _File.model_validate(parse_toml(path.read_bytes()))
    except OSError as error:
        raise ConfigError(f"{where}: can't be read ({error.strerror})") from error
    except TomlError as error:
        raise ConfigError(f"{where}: isn't TOML ({error})", "CFG003") from error
    except ValidationError as error:
        raise ConfigError(f"{where}: {first_wrong(error)}", "CFG003") from error
    parts = []
    for entry in file.conditions:
        if _FILE in entry.name:
            raise ConfigError(f"{where}: {entry.name} runs code; name it on the command line")
        if entry.severity is not None and entry.value is not None:
            raise ConfigError(f"{where}: '{entry.name}': give either severity or value")
        strength = entry.value or (_DEFAULT if entry.severity is None else str(entry.severity))
        begin, end = (None if s is None else round(s * 1e9) for s in (entry.from_s, entry.to_s))
        parts.append(_make(where, entry.name, strength, entry.sensors, begin, end))
    return tuple(part for part in parts if part is not None)
