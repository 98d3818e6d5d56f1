"""What `fbench plugins` prints."""

from collections.abc import Mapping, Sequence
from typing import Any, get_args

from rich.table import Table

from fbench.replay.cli.show import console
from fbench.replay.errors import ConfigError
from fbench.replay.field_docs import parameter_docs
from fbench.replay.names import did_you_mean
from fbench.replay.plugins import Group, default_params, found, load, pipeline_class, pipeline_parameters
from fbench.replay.settings import BY_SENSOR, describe, has_sensor_settings
from fbench.replay.variant_file import Variant
from fbench.replay.variants import built_in_variants, variant_of

_GROUPS: tuple[Group, ...] = get_args(Group)
_WITH_PARAMETERS: tuple[Group, ...] = ("datasets", "pipelines")


def show_group(name: str | None) -> None:
    """List the plug-ins of one group, or of all."""
    table = Table(box=None, pad_edge=False)
    for column in ("group", "name", "where"):
        table.add_column(column)
    for group in _GROUPS if name is None else (_group(name),):
        for point in found(group).values():
            table.add_row(group, point.name, point.value)
        for variant, point in built_in_variants() if group == "pipelines" else ():
            table.add_row(group, variant.name, f"{point.value}, a variant of {variant.base}")
    console().print(table)


def show_parameters(group: str, name: str) -> None:
    """List the parameters of a pipeline or variant, or of the importer of a dataset, with their defaults."""
    if (kind := _group(group)) not in _WITH_PARAMETERS:
        raise ConfigError(f"only {' and '.join(_WITH_PARAMETERS)} have parameters, not {group}")
    variant = variant_of(name) if kind == "pipelines" else None
    if variant is not None:
        _show_variant(variant, default_params(pipeline_class(name)), pipeline_parameters(name, []))
        return
    params = default_params(load(kind, name))
    if params is None:
        console().print(f"{name} takes no parameters")
        return
    rows = [(path, _shown(value)) for path, value in describe(params).items()]
    _show_table(("parameter", "default"), rows, params)


def _show_variant(variant: Variant, params: Any, values: Mapping[str, object]) -> None:
    """Say what a variant is, and list all parameters; the default stands beside those that it sets."""
    out, sensors = console(), ", ".join(variant.sensors)
    for line in (variant.title, f"base: {variant.base}", sensors and f"sensors: {sensors}"):
        if line:
            out.print(line, markup=False, soft_wrap=True)
    defaults, sets = describe(params), {name for name, _ in variant.settings}
    rows = [(path, _shown(v), _shown(defaults.get(path)) if path in sets else "") for path, v in values.items()]
    if rows:
        _show_table(("parameter", "value", "instead of"), rows, params)


def _show_table(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], params: Any) -> None:
    """Print rows that begin with a parameter's name, with its meaning at the end."""
    table, docs = Table(box=None, pad_edge=False), parameter_docs(params)
    for column in columns:
        table.add_column(column, no_wrap=True)
    table.add_column("meaning")
    for row in rows:
        table.add_row(*row, docs.get(row[0], ""))
    if has_sensor_settings(params):
        table.add_row("SENSOR.NAME", *("" for _ in columns[1:]), docs.get(BY_SENSOR, ""))
    console().print(table)


def _shown(value: object) -> str:
    if isinstance(value, list):
        return ",".join(map(_shown, value))
    return "none" if value is None else str(value)


def _group(name: str) -> Group:
    for group in _GROUPS:
        if group == name:
            return group
    raise ConfigError(f"unknown group '{name}'{did_you_mean(name, (*_GROUPS, 'profiles'))}")
