"""Named variants of pipelines: built-in ones as `GROUP/NAME`, anybody's as `FILE.toml`."""

import re
from collections.abc import Iterator, Sequence
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from fbench.replay.errors import ConfigError
from fbench.replay.files import expanded, is_file
from fbench.replay.names import did_you_mean
from fbench.replay.settings import apply_settings, names_file
from fbench.replay.variant_file import SUFFIX, Variant, parsed_variant, read_variant

_BUILT_IN = re.compile(r"[\w.-]+/[\w.-]+")


def variant_of(pipeline: str) -> Variant | None:
    """Return the variant that a pipeline's name means; `None` where it means none, or nothing.

    Raises:
        ConfigError: where its file can't be used, or a group has none of that name (with the nearest one).
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
    return _built_in(group, found[name])


def built_in_variants() -> Iterator[tuple[Variant, EntryPoint]]:
    """Give all that come with fbench and with plug-ins, by name, and by which entry point each comes in."""
    for group, point in _groups().items():
        for file in _files(point).values():
            yield _built_in(group, file), point


def sensors_of(pipeline: str, given: Sequence[str]) -> list[str]:
    """Return the patterns of sensors that a pipeline gets: those given, else those of the variant that it is."""
    variant = variant_of(pipeline)
    return list(given or (() if variant is None else variant.sensors))


def variant_settings(variant: Variant, params: Any) -> list[str]:
    """Return what a variant sets, as `--set` takes it, checked against the parameters of its base.

    Raises:
        ConfigError: naming the file, for an unknown parameter (with the nearest one) or a wrong value.
    """
    if params is None and variant.settings:
        raise ConfigError(f"{variant.where}: pipeline '{variant.base}' takes no parameters")
    settings = [f"{name}={_placed(variant, params, name, value)}" for name, value in variant.settings]
    try:
        apply_settings(params, settings)
    except ConfigError as error:
        raise ConfigError(f"{variant.where}: {str(error).removeprefix('--set ')}", "CFG003") from error
    return settings


def _placed(variant: Variant, params: Any, name: str, value: str) -> str:
    """A value; that of a relative path as seen from here. What has neither folder nor suffix may be a name."""
    if variant.folder is None or not names_file(params, name, value):
        return value
    path = expanded(value)
    beside = variant.folder / path
    is_path = bool(path.suffix) or path.parent != Path() or is_file(beside)
    return str(beside.absolute()) if is_path else value


def _groups() -> dict[str, EntryPoint]:
    """Packages that hold variants, by the name of their group."""
    return {point.name: point for point in sorted(entry_points(group="fbench.variants"), key=lambda p: p.name)}


def _files(point: EntryPoint) -> dict[str, Traversable]:
    """Files of a package, by name, sorted.

    Raises:
        ConfigError: where the package can't be imported.
    """
    try:
        found = [file for file in files(point.value).iterdir() if file.name.endswith(SUFFIX)]
    except (ImportError, TypeError, OSError) as error:
        raise ConfigError(f"variants '{point.name}' ({point.value}) can't be loaded: {error}") from error
    return {file.name.removesuffix(SUFFIX): file for file in sorted(found, key=lambda file: file.name)}


def _built_in(group: str, file: Traversable) -> Variant:
    folder = file.parent if isinstance(file, Path) else None
    return parsed_variant(file.read_bytes(), f"{group}/{file.name}", folder, group)
