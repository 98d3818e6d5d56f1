"""Choosing the sensors that a pipeline gets."""

from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase

from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean


def make_sensors(texts: Sequence[str]) -> list[str]:
    """Read `--sensors`: patterns, several of them with commas between.

    Raises:
        ConfigError: where one is empty.
    """
    patterns = [part.strip() for text in texts for part in text.split(",")]
    if any(not pattern.removeprefix("!") for pattern in patterns):
        raise ConfigError("--sensors: a pattern is empty, expected names such as front* or !radar")
    return patterns


def chosen_sensors(names: Collection[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """Return those of the sensors, sorted, whose name fits a pattern (`*`, `?`, `[...]`); `!` before a pattern leaves
    out what fits it. Without patterns all are chosen.

    Raises:
        ConfigError: where a pattern fits no sensor, or nothing is left.
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
