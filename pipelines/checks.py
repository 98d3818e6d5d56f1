"""Checks of parameters, made once when they are read."""

import math

from fbench.replay.errors import ConfigError


def require_between(name: str, value: float, low: float, high: float = math.inf) -> None:
    """Refuse a parameter outside of [low, high].

    Raises:
        ConfigError: naming the parameter, what is expected and what was given.
    """
    if not low <= value <= high:
        limits = f"at least {low:g}" if high == math.inf else f"between {low:g} and {high:g}"
        raise ConfigError(f"{name}: expected {limits}, got {value:g}")
