"""The metadata record `fbench` of an MCAP log: its id, its metadata and the kinds of its sensors.

MCAP protects no metadata record by a checksum, so the record carries its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import blake2b

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.rig import KINDS, Kind, LogInfo, Rig

NAME = "fbench"
_ID, _DIGEST, _METADATA, _SENSOR = "log_id", "digest", "metadata.", "sensor."


@dataclass(frozen=True)
class LogHeader:
    """What an fbench log says about itself."""

    log_id: str
    metadata: Mapping[str, str] = field(default_factory=dict)
    kinds: Mapping[str, Kind] = field(default_factory=dict)
    """Of the sensors of the rig, by name."""


def header_of(info: LogInfo, rig: Rig) -> LogHeader:
    """Return what a log with this rig says about itself."""
    return LogHeader(info.log_id, info.metadata, {name: mount.kind for name, mount in rig.mounts.items()})


def header_record(about: LogHeader) -> dict[str, str]:
    """Return the content of the record: equal logs give equal records."""
    items = {_ID: about.log_id}
    items |= {_METADATA + key: value for key, value in sorted(about.metadata.items())}
    items |= {_SENSOR + name: kind for name, kind in sorted(about.kinds.items())}
    return {**items, _DIGEST: _digest(items)}


def read_header(record: Mapping[str, str]) -> LogHeader:
    """Read what `header_record` made.

    Raises:
        DecodeError: where the record was changed.
    """
    items = {key: value for key, value in record.items() if key != _DIGEST}
    if record.get(_DIGEST) != _digest(items) or _ID not in items:
        raise DecodeError("its digest doesn't match")
    return LogHeader(
        items[_ID],
        _under(_METADATA, items),
        {name: KINDS[kind] for name, kind in _under(_SENSOR, items).items() if kind in KINDS},
    )


def _under(prefix: str, items: Mapping[str, str]) -> dict[str, str]:
    return {key[len(prefix) :]: value for key, value in items.items() if key.startswith(prefix)}


def _digest(items: Mapping[str, str]) -> str:
    digest = blake2b(digest_size=16)
    for text in (text for item in sorted(items.items()) for text in item):
        data = text.encode(errors="surrogateescape")
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()
