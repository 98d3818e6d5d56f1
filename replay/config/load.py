"""Reading an `fbench.toml`, which is untrusted input."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import BaseModel, ValidationError

from fbench.replay.config.model import BodyTable, BoxesTable, Config, FramesTable, SensorTable
from fbench.replay.errors import ConfigError
from fbench.replay.logs.setup import BoxSource, SensorSetup, Setup
from fbench.replay.names import did_you_mean
from fbench.replay.rig_patch import RigPatch
from fbench.replay.rigfiles.open import open_rig_file
from fbench.replay.toml_file import TomlError, parse_toml

MAX_BYTES = 1024 * 1024
_TABLES: Mapping[str, type[BaseModel]] = {
    "frames": FramesTable, "body": BodyTable, "truth": BoxesTable, "results": BoxesTable,
}  # fmt: skip


def load_config(path: Path) -> Config:
    """Read a file.

    Raises:
        ConfigError: where it can't be read, isn't TOML, or holds what isn't known; names the key.
    """
    try:
        return Config.model_validate(parse_toml(_content(path)))
    except TomlError as error:
        raise ConfigError(f"{path}: not TOML: {error}", "CFG003") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {_first(error)}", "CFG003") from error


def setup_of(config: Config, path: Path) -> Setup:
    """Return what a configuration that was read from `path` says about a log.

    Raises:
        ConfigError: where a file that it names is missing, damaged, or lies outside of its folder.
    """
    patch = RigPatch()
    for name in config.body.rig:
        patch = patch.over(open_rig_file(inside(path, name)))
    return Setup(
        sensors={name: _sensor(table) for name, table in config.sensors.items()},
        body=config.body.frame,
        pose=config.body.pose,
        world=config.body.world,
        rig=patch,
        truth_topics=config.truth.topics,
        result_topics=config.results.topics or (),
        truth=_source(config.truth, path),
        results=_source(config.results, path),
        classes=config.classes,
        source=str(path),
    )


def inside(config: Path, name: str) -> Path:
    """Path of a file that a configuration names: it must lie in the configuration's folder, or below, and so must all
    that the links in a folder lead to.

    Raises:
        ConfigError: where it doesn't.
    """
    folder = config.parent.resolve()
    if Path(name).is_absolute() or not _is_inside(folder, folder / name):
        raise ConfigError(f"{config}: '{name}' lies outside of its folder; name it on the command line", "SEC002")
    if not (folder / name).exists():
        raise ConfigError(f"{config}: '{name}': no such file or folder")
    for entry in _links(folder / name):
        if not _is_inside(folder, entry):
            raise ConfigError(f"{config}: '{name}' holds '{entry.name}', a link out of its folder", "SEC002")
    return config.parent / name


def _is_inside(folder: Path, path: Path) -> bool:
    try:
        return path.resolve().is_relative_to(folder)
    except (OSError, RuntimeError, ValueError):  # too long, a loop of links, a NUL
        return False


def _links(path: Path) -> Iterator[Path]:
    for at, folders, files in os.walk(path):
        yield from (entry for name in sorted(folders + files) if (entry := Path(at, name)).is_symlink())


def _sensor(table: SensorTable) -> SensorSetup:
    return SensorSetup(
        topic=table.topic,
        kind=table.kind,
        frame=table.frame,
        calibration=table.calibration,
        doppler=table.doppler,
        ego_motion=table.ego_motion,
        velocity_period_mps=table.velocity_period_mps,
        optional=table.optional,
    )


def _source(table: BoxesTable, path: Path) -> BoxSource | None:
    if table.file is None:
        return None
    return BoxSource(inside(path, table.file), table.format, table.frame, table.camera)


def _content(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
            raise ConfigError(f"{path}: not a regular file; name an fbench.toml")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES} bytes, which no configuration needs", "CFG003")
        return data
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror})") from error


def _first(error: ValidationError) -> str:
    """The first thing that is wrong, with its key."""
    found = error.errors(include_url=False, include_context=False)[0]
    keys = [str(part) for part in found["loc"]]
    place = ".".join(keys)
    if found["type"] == "extra_forbidden":
        return f"'{place}' isn't known{did_you_mean(keys[-1], _known(keys))}"
    if found["type"] == "missing":
        return f"'{place}' is missing"
    text = found["msg"].removeprefix("Value error, ")
    return f"'{place}': {text}"


def _known(keys: list[str]) -> list[str]:
    if len(keys) == 1:
        return list(Config.model_fields)
    table: type[BaseModel] = SensorTable if keys[0] == "sensors" else _TABLES.get(keys[0], Config)
    return list(table.model_fields)
