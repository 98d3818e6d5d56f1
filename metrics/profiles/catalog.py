"""Every profile by its name, from the entry points `fbench.profiles`, and its description."""

import inspect
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, cast

from fbench.replay.contracts.entry_points import entry_points_of, load
from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, one_line
from fbench.replay.contracts.profiles import Facts, Match, Profile

AnyProfile = Profile[Any]


def profile_names() -> list[str]:
    """Return the name of every profile that is installed, `default` first; none of them is imported."""
    return sorted(entry_points_of("profiles"), key=lambda name: (name != "default", name))


def profile_of(name: str) -> AnyProfile:
    """Return a profile by name or `FILE.py:CLASS`. ConfigError: an unknown name, with the nearest, or no profile."""
    loaded = load("profiles", name)
    try:
        profile = loaded() if inspect.isclass(loaded) else loaded
        is_one = isinstance(profile, Profile) and isinstance(profile.facts, Facts)
    except INTERRUPTS:
        raise
    except BaseException as error:
        raise ConfigError(f"profile '{name}' can't be made: {one_line(error)}") from error
    if not is_one:
        raise ConfigError(f"profile '{name}' isn't one: see Profile and Facts in fbench.replay.contracts.profiles")
    return cast("AnyProfile", profile)


def describe_rules(profile: AnyProfile) -> dict[str, str]:
    """Return all that a profile fixes, by dotted names."""
    return {path: text for path, text in _items("", profile) if path not in ("name", "summary")}


def _items(path: str, value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, Match):
        yield path, str(value)
    elif is_dataclass(value):
        for own in fields(value):
            yield from _items(f"{path}.{own.name}" if path else own.name, getattr(value, own.name))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _items(f"{path}.{key}", item)
    elif isinstance(value, tuple) and any(is_dataclass(item) and not isinstance(item, Match) for item in value):
        for i, item in enumerate(value):
            yield from _items(f"{path}[{i}]", item)
    else:
        yield path, _text(value)


def _text(value: object) -> str:
    if isinstance(value, str | Match):
        return str(value) or "–"
    if isinstance(value, Collection):
        texts = [_text(item) for item in value]
        return ", ".join(sorted(texts) if isinstance(value, set | frozenset) else texts) or "–"
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
