"""Rigs of a log that can be moved as data, and not only as the messages that tell them."""

from collections.abc import Mapping, Sequence
from itertools import groupby

from fbench.replay.errors import LogError
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.convert.encode import Encoder
from fbench.replay.logs.convert.exact import is_same
from fbench.replay.logs.convert.items import RigAt
from fbench.replay.logs.parquet.folder import ParquetFolder
from fbench.replay.logs.read_rig import RigState
from fbench.replay.logs.roles import Role

_KINDS = ("transform", "calibration")
_MAX_RIGS = 1000
"""Rigs that change all the time stay messages, which are streamed."""


def rig_channels(roles: Mapping[int, Role]) -> frozenset[int]:
    """Channels that tell the rig."""
    return frozenset(id_ for id_, role in roles.items() if role.kind in _KINDS)


def stored_rigs(container: Container) -> list[RigAt]:
    """Rigs that the container holds as data."""
    stamps: Sequence[int | None] = (
        container.rig_stamps if isinstance(container, ParquetFolder) else [None] * len(container.rigs)
    )
    return [RigAt(log_ns, rig, stamp) for (log_ns, rig), stamp in zip(container.rigs, stamps, strict=True)]


def told_rigs(container: Container, roles: Mapping[int, Role], encoder: Encoder) -> list[RigAt] | None:
    """Rigs that the messages of an fbench log tell; `None` where encoding them again would give other messages."""
    channels = rig_channels(roles)
    if not all(roles[id_].is_own for id_ in channels):
        return None
    state = RigState(container, roles)
    found: list[RigAt] = []
    for _, group in groupby(container.entries(channels), key=lambda entry: entry.log_ns):
        rig = _told_rig(container, state, list(group), encoder)
        if rig is None or len(found) == _MAX_RIGS:
            return None
        found.append(rig)
    return found


def _told_rig(container: Container, state: RigState, entries: Sequence[Entry], encoder: Encoder) -> RigAt | None:
    for entry in entries:
        state.take(entry)
    log_ns, stamp_ns = entries[0].log_ns, entries[0].publish_ns
    try:
        rig = state.rig()
        encoded = sorted(encoder.rig(stamp_ns, rig), key=lambda message: message.channel.topic)
    except (LogError, ValueError):
        return None
    channels = [container.channels[entry.channel] for entry in entries]
    same = len(encoded) == len(entries) and all(map(is_same, encoded, channels, entries))
    return RigAt(log_ns, rig, stamp_ns) if same else None
