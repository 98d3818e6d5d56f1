"""Metric definitions: what each metric that a row can have means, read from the TOML files of this folder."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, Literal

from fbench.replay.contracts.errors import ConfigError, did_you_mean

Better = Literal["higher", "lower", "neither"]


@dataclass(frozen=True)
class Source:
    """Where a definition is published."""

    authors: str
    year: int
    title: str
    url: str

    def __str__(self) -> str:
        return f"{self.authors} ({self.year}), {self.title}, {self.url}"


@dataclass(frozen=True)
class MetricDefinition:
    """What one number means."""

    name: str
    meaning: str
    source: Source
    formula: str = "a count"
    range: str = "0 to 1"
    better: Better = "higher"
    undefined: str = ""  # When it is null; empty: never, or where all of a profile's rows are
    unit: str = "1"  # `1` for shares and counts
    is_count: bool = False
    by_profile: Mapping[str, str] = field(default_factory=dict)  # What is different in a profile


def _read(name: str) -> dict[str, dict[str, Any]]:
    return tomllib.loads((resources.files(__package__) / f"{name}.toml").read_text(encoding="utf-8"))


def _definitions() -> Mapping[str, MetricDefinition]:
    sources = {name: Source(**entry) for name, entry in _read("sources").items()}
    found = {}
    entries = _read("detection") | _read("tracking") | _read("criticality") | _read("events")
    for name, entry in entries.items():
        entry["source"] = sources[entry["source"]]
        if entry.get("is_count"):
            entry["range"] = "from 0 up"
        found[name] = MetricDefinition(name, **entry)
    return found


DEFINITIONS = _definitions()
COUNTS = frozenset(definition.name for definition in DEFINITIONS.values() if definition.is_count)


def definition_of(name: str) -> MetricDefinition:
    """Return the definition of a metric. Raises ConfigError for an unknown name, with the nearest one."""
    if name not in DEFINITIONS:
        raise ConfigError(f"unknown metric '{name}'{did_you_mean(name, DEFINITIONS)}")
    return DEFINITIONS[name]
