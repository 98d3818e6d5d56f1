"""Named variants of pipelines: built-in ones as `GROUP/NAME`, anybody's as `FILE.toml`."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any

from fbench.replay.contracts.entry_points import find_installed
from fbench.replay.contracts.errors import ConfigError, did_you_mean, wrong_key
from fbench.replay.contracts.settings import apply_settings, names_file
from fbench.replay.data.files import expand_user, is_file
from fbench.replay.formats.documents import TomlError, parse_toml

SUFFIX = ".toml"
MAX_BYTES = 1024 * 1024
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}"
_MAX_INT = 2**63


@dataclass(frozen=True)
class Variant:
    """A pipeline with parameters and sensors of its own choice."""

    name: str  # What runs are called by: `GROUP/NAME` where it is built in
    title: str  # What it is, in one line; may be empty
    base: str  # Name of the pipeline
    settings: tuple[tuple[str, str], ...]  # Parameters that it sets: dotted names and values, as `--set` takes them
    sensors: tuple[str, ...]  # Patterns of sensors, as `--sensors` takes them; empty: all
    where: str  # The file, for errors
    folder: Path | None  # What relative paths of files are relative to; `None`: nothing is

    @property
    def file_name(self) -> str:
        """Its name as part of names of files: `thesis-late3d`."""
        return self.name.replace("/", "-")


@cache
def _table() -> Any:
    """What a file may hold, as pydantic has it."""
    from pydantic import BaseModel, ConfigDict, Field  # takes a while to import

    class Table(BaseModel):
        model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

        name: str
        title: Annotated[str, Field(max_length=200)] = ""
        base: Annotated[str, Field(min_length=1, max_length=200)]
        sensors: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=1000)], ...], Field(strict=False)] = ()
        detect_every: int | None = None
        parameters: dict[str, Any] = {}

    return Table


def read_variant(path: Path) -> Variant:
    """Read a file. Raises ConfigError where it can't be read, isn't TOML, or holds what isn't known; names file and
    key.
    """
    return parse_variant(read_config(path, "name the TOML file of a variant", "variant"), str(path), path.parent)


def parse_variant(content: bytes, where: str, folder: Path | None, group: str = "") -> Variant:
    """Return the variant that a file's content defines; `group` is what precedes the name of a built-in one. Raises
    ConfigError as `read_variant` does.
    """
    from pydantic import ValidationError

    try:
        table = _table().model_validate(parse_toml(content))
        if not re.fullmatch(_NAME, table.name):
            raise TomlError("'name': expected at most 60 letters, digits, and '_', '-', '.' between them")
        settings = dict[str, str]()
        every = () if table.detect_every is None else (("detect_every", str(table.detect_every)),)
        for name, value in (*every, *_settings("", table.parameters)):
            if name in settings:
                raise TomlError(f"'{name}' is set twice")
            settings[name] = value
    except TomlError as error:
        raise ConfigError(f"{where}: {error}", "CFG003") from error
    except ValidationError as error:
        hint = "; parameters of the pipeline belong under [parameters]"
        raise ConfigError(f"{where}: {wrong_key(error, lambda _: _table(), hint)}", "CFG003") from error
    full_name = f"{group}/{table.name}" if group else table.name
    return Variant(full_name, table.title, table.base, tuple(settings.items()), table.sensors, where, folder)


def _settings(prefix: str, table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in table.items():
        name = f"{prefix}{key}"
        if "=" in key:
            raise TomlError(f"'{name}': a parameter's name has no '='")
        if isinstance(value, Mapping):
            yield from _settings(f"{name}.", value)
        elif isinstance(value, list):
            yield name, ",".join(_text(name, item) for item in value)
        else:
            yield name, _text(name, value)


def _text(name: str, value: object) -> str:
    """A single value as `--set` takes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | float) or (isinstance(value, int) and abs(value) < _MAX_INT):
        return str(value)
    raise TomlError(f"'{name}': expected text, a number, true or false, or a list of these")


def read_config(path: Path, hint: str, what: str) -> bytes:
    """Return the content of a file that somebody wrote for fbench. Raises ConfigError where it can't be read, isn't a
    file, which `hint` then follows, or is larger than any such file need be, `what` it is.
    """
    try:
        if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
            raise ConfigError(f"{path}: not a regular file; {hint}")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror})") from error
    if len(data) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES} bytes, which no {what} needs", "CFG003")
    return data


_BUILT_IN = re.compile(r"[\w.-]+/[\w.-]+")


def variant_of(pipeline: str) -> Variant | None:
    """Return the variant that a pipeline's name means; `None` where it means none, or nothing. Raises ConfigError where
    its file can't be used, or a group has none of that name (with the nearest one).
    """
    if pipeline.endswith(SUFFIX):
        return read_variant(Path(pipeline))
    group, _, name = pipeline.partition("/")
    groups = _groups()
    if not _BUILT_IN.fullmatch(pipeline) or group not in groups:
        return None
    found = _files(groups[group])
    if name not in found:
        raise ConfigError(f"unknown pipeline '{pipeline}'{did_you_mean(pipeline, (f'{group}/{n}' for n in found))}")
    return _read_built_in(group, found[name])


def find_variants() -> Iterator[tuple[Variant, EntryPoint]]:
    """Give all that come with fbench and with plug-ins, by name, and by which entry point each comes in."""
    for group, point in _groups().items():
        for file in _files(point).values():
            yield _read_built_in(group, file), point


def sensors_of(pipeline: str, given: Sequence[str]) -> list[str]:
    """Return the patterns of sensors that a pipeline gets: those given, else those of the variant that it is."""
    variant = variant_of(pipeline)
    return list(given or (() if variant is None else variant.sensors))


def variant_settings(variant: Variant, params: Any) -> list[str]:
    """Return what a variant sets, as `--set` takes it, checked against the parameters of its base. Raises ConfigError
    naming the file, for an unknown parameter (with the nearest one) or a wrong value.
    """
    if params is None and variant.settings:
        raise ConfigError(f"{variant.where}: pipeline '{variant.base}' takes no parameters")
    settings = [f"{name}={_place(variant, params, name, value)}" for name, value in variant.settings]
    try:
        apply_settings(params, settings)
    except ConfigError as error:
        raise ConfigError(f"{variant.where}: {str(error).removeprefix('--set ')}", "CFG003") from error
    return settings


def _place(variant: Variant, params: Any, name: str, value: str) -> str:
    """A value; that of a relative path as seen from here. What has neither folder nor suffix may be a name."""
    if variant.folder is None or not names_file(params, name, value):
        return value
    path = expand_user(value)
    beside = variant.folder / path
    is_path = bool(path.suffix) or path.parent != Path() or is_file(beside)
    return str(beside.absolute()) if is_path else value


def _groups() -> dict[str, EntryPoint]:
    """Packages that hold variants, by the name of their group."""
    return {point.name: point for point in sorted(find_installed("variants"), key=lambda p: p.name)}


def _files(point: EntryPoint) -> dict[str, Traversable]:
    """Files of a package, by name, sorted. Raises ConfigError where the package can't be imported."""
    try:
        found = [file for file in files(point.value).iterdir() if file.name.endswith(SUFFIX)]
    except (ImportError, TypeError, OSError) as error:
        raise ConfigError(f"variants '{point.name}' ({point.value}) can't be loaded: {error}") from error
    return {file.name.removesuffix(SUFFIX): file for file in sorted(found, key=lambda file: file.name)}


def _read_built_in(group: str, file: Traversable) -> Variant:
    folder = file.parent if isinstance(file, Path) else None
    return parse_variant(file.read_bytes(), f"{group}/{file.name}", folder, group)
