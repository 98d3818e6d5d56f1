"""`log.json` of a Parquet log: what the log says about itself, its rigs and its streams."""

import base64
import binascii
import json
import re
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fbench.replay.contracts.errors import DataError, LogError, wrong_field
from fbench.replay.data.rig import CameraModel, Kind, Mount, Rig
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.containers.parquet.columns import StreamKind
from fbench.replay.logs.coordinate_frames import invalid

Natural = Annotated[int, Field(ge=0, lt=2**64)]


class Strict(BaseModel):
    """Nothing unknown, no conversions, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class MountEntry(Strict):
    """A sensor's pose on the body."""

    kind: Kind
    translation_m: list[float]
    rotation_xyzw: list[float]


class CameraEntry(Strict):
    """Intrinsics of a camera."""

    K: list[list[float]]
    size_wh: Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]
    distortion_model: str = ""
    distortion: list[float] = Field(default_factory=list)


class RigEntry(Strict):
    """A rig, and from when it holds."""

    log_ns: Natural = 0
    stamp_ns: Natural | None = None  # Stamp of the messages that told it, where there were any
    mounts: dict[str, MountEntry] = Field(default_factory=dict)
    cameras: dict[str, CameraEntry] = Field(default_factory=dict)

    @classmethod
    def of(cls, log_ns: int, rig: Rig, stamp_ns: int | None = None) -> Self:
        """Return a rig in the form of `log.json`."""
        mounts = {
            name: MountEntry(
                kind=m.kind, translation_m=m.translation_m.tolist(), rotation_xyzw=m.rotation_xyzw.tolist()
            )
            for name, m in sorted(rig.mounts.items())
        }
        cameras = {
            name: CameraEntry(
                K=c.K.tolist(), size_wh=list(c.size_wh), distortion_model=c.distortion_model,
                distortion=c.distortion.tolist(),
            )
            for name, c in sorted(rig.cameras.items())
        }  # fmt: skip
        return cls(log_ns=log_ns, stamp_ns=stamp_ns, mounts=mounts, cameras=cameras)

    def rig(self) -> Rig:
        """Return the rig as data. Raises LogError naming the sensor whose pose isn't one, or whose intrinsics aren't
        intrinsics.
        """
        mounts = {name: _mount(name, entry) for name, entry in sorted(self.mounts.items())}
        cameras = {name: _camera(name, entry) for name, entry in sorted(self.cameras.items())}
        return Rig(mounts, cameras)


def _mount(name: str, entry: MountEntry) -> Mount:
    try:
        mount = Mount(entry.kind, np.array(entry.translation_m, "f8"), np.array(entry.rotation_xyzw, "f8"))
    except DataError as error:
        raise LogError(f"sensor '{name}': {error}", "CAL001") from error
    if why := invalid(mount.translation_m, mount.rotation_xyzw):
        raise LogError(f"sensor '{name}' has no valid pose ({why})", "CAL001")
    return mount


def _camera(name: str, entry: CameraEntry) -> CameraModel:
    try:
        K, distortion = np.array(entry.K, "f8"), np.array(entry.distortion, "f8")
        camera = CameraModel(K, (entry.size_wh[0], entry.size_wh[1]), entry.distortion_model, distortion)
    except (DataError, ValueError) as error:
        raise LogError(f"camera '{name}': {error}", "CAL001") from error
    if not camera.is_sound:
        raise LogError(f"camera '{name}' has no valid focal length, center and distortion", "CAL001")
    return camera


NAME = "log.json"
FORMAT = "fbench-parquet"
VERSION = 1
MAX_BYTES = 16 * 1024 * 1024  # Bounds the memory that parsing takes

_NUMBERS = re.compile(r"\[\n([-+.eE0-9,\s]+)\]")
"""Lists of numbers, which then fit one line; line breaks inside texts are escaped in JSON."""

Crc32 = Annotated[int, Field(ge=0, lt=2**32)]


class ChannelEntry(Strict):
    """What another program said about a topic that is kept as it was."""

    encoding: str
    schema_name: str | None = None
    schema_encoding: str = ""
    schema_data: str = ""  # In base64
    metadata: dict[str, str] = Field(default_factory=dict)

    @classmethod
    def of(cls, channel: Channel) -> Self:
        """Return a channel in the form of `log.json`."""
        about: dict[str, str] = {}
        if (schema := channel.schema) is not None:
            about = {"schema_name": schema.name, "schema_encoding": schema.encoding}
            about["schema_data"] = base64.b64encode(schema.data).decode()
        return cls(encoding=channel.encoding, metadata=dict(channel.metadata), **about)

    def channel(self, topic: str) -> Channel:
        """Return the channel. Raises LogError where its schema isn't base64."""
        if self.schema_name is None:
            return Channel(topic, self.encoding, None, self.metadata)
        try:
            data = base64.b64decode(self.schema_data, validate=True)
        except (binascii.Error, ValueError) as error:
            raise LogError(f"topic '{topic}': its schema isn't base64 ({error})", "PQ001") from error
        return Channel(topic, self.encoding, Schema(self.schema_name, self.schema_encoding, data), self.metadata)


class GroupEntries(Strict):
    """What is known of each row group of a file, column by column."""

    offset: list[Natural]  # Where it begins in the file [byte]
    length: list[Natural]
    crc32: list[Crc32]  # Of all its bytes
    index_crc32: list[Crc32]  # Of the bytes of its first column, `log_ns`
    num_rows: list[Natural]
    min_log_ns: list[Natural]
    max_log_ns: list[Natural]

    @model_validator(mode="after")
    def _one_length(self) -> Self:
        if len({len(column) for _, column in self}) > 1:
            raise ValueError("columns of different length")
        return self


class Checksums(Strict):
    """How the bytes of a file are verified."""

    size: Natural  # Of the file [byte]
    blake2b: str  # Of the whole file, 128 bits in hexadecimal digits
    footer_crc32: Crc32  # Of everything after the last row group
    row_groups: GroupEntries


class StreamEntry(Strict):
    """One stream: the messages of one sensor, one kind of truth, or one topic of another program."""

    file: str
    kind: StreamKind
    sensor: str = ""
    topic: str = ""  # Empty: as fbench names it after kind and sensor
    channel: ChannelEntry | None = None
    num_rows: Natural | None = None
    first_log_ns: Natural | None = None
    last_log_ns: Natural | None = None
    checksums: Checksums | None = None


class LogJson(Strict):
    """The whole of `log.json`; only format, version and streams must be there."""

    format: Literal["fbench-parquet"] = FORMAT  # type: ignore[assignment]
    version: Literal[1] = 1
    log_id: str | None = None
    metadata: dict[str, str] = Field(default_factory=dict)
    rigs: list[RigEntry] = Field(default_factory=list)
    sensors: dict[str, Kind] = Field(default_factory=dict)
    """Sensors of the log where messages tell its rig, also those without messages."""
    streams: list[StreamEntry]


def dump(log: LogJson) -> bytes:
    """Return the content of the file, with its own digest. Raises ValueError where a text isn't Unicode, or the whole
    would be too large to be read again.
    """
    content = log.model_dump(exclude_none=True)
    text = json.dumps({**content, "digest": _digest(content)}, indent=1, allow_nan=False, ensure_ascii=False)
    data = _NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text).encode()
    if len(data) > MAX_BYTES:
        raise ValueError(f"{NAME} would have {len(data)} bytes; write more rows a group")
    return data + b"\n"


def parse(where: str, data: bytes) -> tuple[LogJson, bool]:
    """Return the content and whether it has a digest, which then was checked. Raises LogError where it isn't what
    `dump` makes, or what the documentation allows.
    """
    try:
        content = json.loads(data.decode(), object_pairs_hook=_unique, parse_constant=_refuse)
        json.dumps(content, ensure_ascii=False).encode()  # half a surrogate pair is no text
    except RecursionError:
        raise LogError(f"{where}: nested too deeply", "PQ001") from None
    except ValueError as error:
        raise LogError(f"{where}: isn't JSON ({error})", "PQ001") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise LogError(f'{where}: not the description of a log ("format": "{FORMAT}" is missing)', "PQ001")
    if content.get("version") != VERSION:
        raise LogError(f"{where}: version {content.get('version')!r}; this fbench reads version {VERSION}", "PQ001")
    digest = content.pop("digest", None)
    if digest is not None and digest != _digest(content):
        raise LogError(f"{where}: damaged, its digest doesn't match; who edits it removes the key 'digest'", "PQ001")
    try:
        return LogJson.model_validate(content), digest is not None
    except ValidationError as error:
        place, why = wrong_field(error)
        raise LogError(f"{where}: '{place}': {why}; see docs/formats.md", "PQ001") from None


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"key {next(n for n in names if names.count(n) > 1)!r} is there twice")
    return result


def _refuse(text: str) -> float:
    raise ValueError(f"{text} isn't a number")


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return blake2b(text.encode(), digest_size=16).hexdigest()
