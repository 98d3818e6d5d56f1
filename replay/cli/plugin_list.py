"""What `fbench plugins` prints."""

from typing import get_args

from rich.table import Table

from fbench.replay.cli.show import console
from fbench.replay.errors import ConfigError
from fbench.replay.field_docs import parameter_docs
from fbench.replay.names import did_you_mean
from fbench.replay.plugins import Group, default_params, found, load
from fbench.replay.settings import BY_SENSOR, describe, has_sensor_settings

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
    console().print(table)


def show_parameters(group: str, name: str) -> None:
    """List the parameters of a pipeline, or of the importer of a dataset, with their defaults."""
    if (kind := _group(group)) not in _WITH_PARAMETERS:
        raise ConfigError(f"only {' and '.join(_WITH_PARAMETERS)} have parameters, not {group}")
    params = default_params(load(kind, name))
    if params is None:
        console().print(f"{name} takes no parameters")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("parameter", "default", "meaning"):
        table.add_column(column, no_wrap=column != "meaning")
    docs = parameter_docs(params)
    for path, value in describe(params).items():
        table.add_row(path, "none" if value is None else str(value), docs.get(path, ""))
    if has_sensor_settings(params):
        table.add_row("SENSOR.NAME", "", docs.get(BY_SENSOR, ""))
    console().print(table)


def _group(name: str) -> Group:
    for group in _GROUPS:
        if group == name:
            return group
    raise ConfigError(f"unknown group '{name}'{did_you_mean(name, (*_GROUPS, 'profiles'))}")
