"""Checks of parameters, made once when they are read."""

from collections.abc import Mapping

from fbench.replay.errors import ConfigError

LIMIT = 1e6
"""No parameter is sensible beyond this; keeps numbers that follow from them finite."""


def require_between(name: str, value: float, low: float, high: float = LIMIT) -> None:
    """Refuse a parameter outside of [low, high].

    Raises:
        ConfigError: naming the parameter, what is expected and what was given.
    """
    if not low <= value <= high:
        limits = f"between {low:g} and {high:g}"
        if high == LIMIT:
            limits = f"at most {high:g}" if value > high else f"at least {low:g}"
        # Integers may be too large for a float's format.
        raise ConfigError(f"{name}: expected {limits}, got {value if isinstance(value, int) else format(value, 'g')}")


def require_ranges(prefix: str, params: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse fields of `params` outside of their range (low, high); `prefix` is what precedes their names.

    Raises:
        ConfigError: see `require_between`.
    """
    for name, (low, high) in ranges.items():
        require_between(f"{prefix}.{name}", getattr(params, name), low, high)
