"""Choosing topics by patterns."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from fbench.replay.errors import ConfigError
from fbench.replay.logs.codec import MESSAGES
from fbench.replay.logs.roles import Role
from fbench.replay.names import did_you_mean


def selected(roles: Mapping[int, Role], patterns: Sequence[str]) -> dict[int, Role]:
    """Keep the measurements and poses whose topic or sensor fits a pattern (`*`, `?`, `[...]`); `!` before a pattern
    leaves out what fits it. Transforms, calibrations of kept cameras and truth stay.

    Raises:
        ConfigError: where a pattern fits nothing.
    """
    streams = {id_: role for id_, role in roles.items() if role.kind in MESSAGES}
    for pattern in patterns:
        if not any(_fits(role, pattern.removeprefix("!")) for role in streams.values()):
            names = sorted({name for role in streams.values() for name in (role.topic, role.sensor)})
            hint = did_you_mean(pattern, names)
            raise ConfigError(f"--topics {pattern}: fits no topic or sensor{hint}", "CFG001")
    wanted = [p for p in patterns if not p.startswith("!")]
    unwanted = [p[1:] for p in patterns if p.startswith("!")]
    dropped = {
        id_: role
        for id_, role in streams.items()
        if (wanted and not any(_fits(role, p) for p in wanted)) or any(_fits(role, p) for p in unwanted)
    }
    kept_sensors = {role.sensor for id_, role in streams.items() if id_ not in dropped}
    gone = {role.sensor for role in dropped.values()} - kept_sensors
    return {
        id_: role
        for id_, role in roles.items()
        if id_ not in dropped and not (role.kind == "calibration" and role.is_own and role.sensor in gone)
    }


def _fits(role: Role, pattern: str) -> bool:
    return fnmatchcase(role.topic, pattern) or fnmatchcase(role.sensor, pattern)
