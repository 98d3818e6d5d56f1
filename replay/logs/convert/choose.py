"""Choosing topics, also those that fbench doesn't understand."""

from collections.abc import Mapping, Sequence

from fbench.replay.logs.codec import MESSAGES
from fbench.replay.logs.container import Container
from fbench.replay.logs.roles import Role
from fbench.replay.logs.selection import selected

_RIG_AND_TRUTH = ("transform", "calibration", "truth")


def chosen(container: Container, roles: Mapping[int, Role], patterns: Sequence[str]) -> frozenset[int]:
    """Channels that the patterns choose; transforms, calibrations of kept cameras and truth stay.

    Raises:
        ConfigError: where a pattern fits nothing.
    """
    if not patterns:
        return frozenset(container.channels)
    # To the patterns, a channel without meaning is a stream that is called like its topic.
    plain = {id_: Role(MESSAGES[0], channel.topic, channel.topic) for id_, channel in container.channels.items()}
    known = {id_: role for id_, role in roles.items() if role.kind in (*MESSAGES, *_RIG_AND_TRUTH)}
    return frozenset(selected({**plain, **known}, patterns))


def left_out(roles: Mapping[int, Role], kept: frozenset[int]) -> frozenset[str]:
    """Sensors that weren't chosen."""
    sensors = {role.sensor for id_, role in roles.items() if id_ in kept}
    return frozenset(role.sensor for role in roles.values()) - sensors
