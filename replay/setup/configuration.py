"""`fbench.toml`: what it may hold, how it is found and read as untrusted input."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from fbench.replay.contracts.errors import ConfigError, did_you_mean, wrong_key
from fbench.replay.contracts.variants import read_config
from fbench.replay.data.boxes import LABELS
from fbench.replay.data.classes import IGNORE
from fbench.replay.data.rig import Kind
from fbench.replay.formats.documents import TomlError, parse_toml
from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.logs.rig_patch import RigPatch
from fbench.replay.logs.setup import MAX_OFFSET_MS, BoxSource, Doppler, EgoMotion, SensorSetup, Setup

NAME = "fbench.toml"

Name = Annotated[str, Field(min_length=1, max_length=1000)]
Length = Annotated[float, Field(gt=0, lt=100, allow_inf_nan=False)]
Duration = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class FramesTable(_Strict):
    """`[frames]`: how messages become frames."""

    reference: Name | None = None
    timeout_ms: Duration | None = None
    tolerance_ms: Duration = 50.0
    max_gap_s: Duration = 2.0
    stamps: Literal["header", "log"] = "header"


class BodyTable(_Strict):
    """`[body]`: where sensors are."""

    frame: str = ""  # Coordinate frame of the body; empty: as its name tells
    pose: str = ""  # Topic with poses of the body in the world; empty: as the log says
    world: str = ""  # Coordinate frame in which poses from `/tf` are wanted; empty: the one above all others
    outline_m: Annotated[tuple[Length, Length, Length], Field(strict=False)] | None = None
    """How far the vehicle reaches from the body's origin to the front, the rear and a side."""
    rig: tuple[Name, ...] = Field(default=(), strict=False, max_length=100)
    """Files with calibration, relative to this one; the first one that names a sensor counts."""


class SensorTable(_Strict):
    """`[sensors.NAME]`: one sensor."""

    topic: Name
    kind: Kind
    frame: str = ""
    calibration: str = ""
    offset_ms: Annotated[float, Field(ge=-MAX_OFFSET_MS, le=MAX_OFFSET_MS, allow_inf_nan=False)] = 0.0
    doppler: Doppler = "receding"
    ego_motion: EgoMotion = "included"
    velocity_period_mps: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)] | None = None
    optional: bool = False


class BoxesTable(_Strict):
    """`[truth]` and `[results]`: boxes, from topics of the log or from a file beside it."""

    topics: tuple[Name, ...] | None = Field(default=None, strict=False)
    file: Name | None = None
    format: str | None = None
    frame: str = ""
    camera: str = ""


class Config(_Strict):
    """A whole `fbench.toml`."""

    version: Literal[1]
    decoder: tuple[Name, ...] = Field(default=(), strict=False, max_length=100)
    """Decoders of messages that fbench doesn't know: names, or `FILE.py:FUNCTION` relative to this file."""
    frames: FramesTable = FramesTable()
    body: BodyTable = BodyTable()
    sensors: dict[Name, SensorTable] = {}  # By name: these topics and no others; without any, the log decides
    truth: BoxesTable = BoxesTable()
    results: BoxesTable = BoxesTable()
    classes: dict[str, str] = {}  # Label of fbench, or `ignore`, by the name that the log gives to a class

    @field_validator("classes")
    @classmethod
    def _labels_exist(cls, classes: dict[str, str]) -> dict[str, str]:
        known = (*LABELS, IGNORE)
        for name, label in classes.items():
            if label not in known:
                raise ValueError(f"'{name}' is to be '{label}', which is no label{did_you_mean(label, known)}")
        return classes


_TABLES: Mapping[str, type[BaseModel]] = {
    "frames": FramesTable, "body": BodyTable, "sensors": SensorTable, "truth": BoxesTable, "results": BoxesTable,
}  # fmt: skip


def load_config(path: Path) -> Config:
    """Read a file. Raises ConfigError where it can't be read, isn't TOML, or holds what isn't known; names the key."""
    data = read_config(path, "name an fbench.toml", "configuration")
    try:
        return Config.model_validate(parse_toml(data))
    except TomlError as error:
        raise ConfigError(f"{path}: not TOML: {error}", "CFG003") from error
    except ValidationError as error:
        why = wrong_key(error, lambda keys: Config if len(keys) == 1 else _TABLES.get(keys[0], Config))
        raise ConfigError(f"{path}: {why}", "CFG003") from error


def setup_of(config: Config, path: Path) -> Setup:
    """Return what a configuration, read from `path`, says of a log. Raises ConfigError for files that can't be used."""
    patch = RigPatch()
    for name in config.body.rig:
        patch = patch.over(open_rig_file(inside(path, name)))
    truth, results = (
        None if t.file is None else BoxSource(inside(path, t.file), t.format, t.frame, t.camera)
        for t in (config.truth, config.results)
    )
    return Setup(
        sensors={
            name: SensorSetup(**table.model_dump(exclude={"offset_ms"})) for name, table in config.sensors.items()
        },
        body=config.body.frame,
        pose=config.body.pose,
        world=config.body.world,
        outline_m=config.body.outline_m,
        rig=patch,
        truth_topics=config.truth.topics,
        result_topics=config.results.topics or (),
        truth=truth,
        results=results,
        classes=config.classes,
        source=str(path),
    )


def inside(config: Path, name: str) -> Path:
    """Path of a file that a configuration names: it must lie in the configuration's folder, or below, and so must all
    that the links in a folder lead to. Raises ConfigError where it doesn't.
    """
    folder = config.parent.resolve()
    if Path(name).is_absolute() or not _is_inside(folder, folder / name):
        raise ConfigError(f"{config}: '{name}' lies outside of its folder; name it on the command line", "SEC002")
    if not (folder / name).exists():
        raise ConfigError(f"{config}: '{name}': no such file or folder")
    for at, folders, files in os.walk(folder / name):
        for entry in sorted(folders + files):
            if Path(at, entry).is_symlink() and not _is_inside(folder, Path(at, entry)):
                raise ConfigError(f"{config}: '{name}' holds '{entry}', a link out of its folder", "SEC002")
    return config.parent / name


def _is_inside(folder: Path, path: Path) -> bool:
    try:
        return path.resolve().is_relative_to(folder)
    except (OSError, RuntimeError, ValueError):  # too long, a loop of links, a NUL
        return False


def config_place(log: Path) -> Path:
    """Return where the configuration of a log belongs: in a folder of parts or of rosbag2, else beside the log."""
    if log.name in ("log.json", "metadata.yaml"):
        log = log.parent
    inside = log.is_dir() and not (log / "log.json").is_file()  # Parquet holds what that lists, and nothing else
    return log / NAME if inside else log.parent / NAME


def find_config(log: Path) -> Path | None:
    """Return the configuration of a log, `None` where there is none."""
    place = config_place(log)
    return place if place.is_file() else None
