"""A profile as the data that it is: thresholds, classes, filters and quirks by their names."""

import inspect
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass

from fbench.metrics.profile import Match
from fbench.metrics.profiles.catalog import AnyProfile

_APART = ("name", "summary")


def described(profile: AnyProfile) -> dict[str, str]:
    """Return all that a profile fixes, by dotted names."""
    return {path: text for path, text in _items("", profile) if path not in _APART}


def explained(profile: AnyProfile) -> str:
    """Return what its class says of how it counts."""
    return inspect.getdoc(type(profile)) or ""


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
