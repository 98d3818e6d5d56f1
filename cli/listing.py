"""Output of `fbench plugins`: plug-ins, metrics and profiles."""

import ast
import inspect
import textwrap
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from itertools import zip_longest
from typing import Any, get_args

from rich.table import Table

from fbench.cli.show import console, make_table, say
from fbench.replay.conditions.spec import load_condition, split_name
from fbench.replay.conditions.weathers import WEATHER_OF
from fbench.replay.contracts.conditions import MakesWeather, needs_of
from fbench.replay.contracts.decoders import load_decoder
from fbench.replay.contracts.entry_points import Group, entry_points_of, load
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.contracts.plugins import default_params, pipeline_class, pipeline_parameters
from fbench.replay.contracts.settings import BY_SENSOR, describe, has_sensor_settings
from fbench.replay.contracts.variants import find_variants, variant_of
from fbench.replay.data.rig import KINDS


def parameter_docs(params: object) -> dict[str, str]:
    """Return the text under each single parameter, by dotted name; empty where there is none."""
    if not is_dataclass(params) or isinstance(params, type):
        return {}
    own, docs = dict[str, str](), dict[str, str]()
    for cls in reversed(type(params).__mro__):
        own |= _docs(cls)
    for f in fields(params):
        value = getattr(params, f.name)
        if is_dataclass(value):
            docs |= {f"{f.name}.{path}": text for path, text in parameter_docs(value).items()}
        else:
            docs[f.name] = own.get(f.name, "")
    return docs


def _docs(cls: type) -> dict[str, str]:
    """Texts under the fields of one class, as documentation tools read them, or beside them as comments."""
    try:
        source = textwrap.dedent(inspect.getsource(cls))
        tree = ast.parse(source)
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    lines, docs = source.splitlines(), dict[str, str]()
    for field, after in zip_longest(body, body[1:]):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            beside = lines[(field.end_lineno or 0) - 1][field.end_col_offset :].strip()
            match after:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    docs[field.target.id] = " ".join(text.split())
                case _ if beside.startswith("# "):
                    docs[field.target.id] = beside[2:]
    return docs


_GROUPS: tuple[Group, ...] = get_args(Group)
_WITH_PARAMETERS: tuple[Group, ...] = ("datasets", "pipelines")


def show_group(name: str | None) -> None:
    """List the plug-ins of one group, or of all."""
    table = make_table("group", "name", "where")
    for group in _GROUPS if name is None else (_require_group(name),):
        for point in entry_points_of(group).values():
            table.add_row(group, point.name, point.value)
        for variant, point in find_variants() if group == "pipelines" else ():
            table.add_row(group, variant.name, f"{point.value}, a variant of {variant.base}")
    console().print(table)


def show_parameters(group: str, name: str) -> None:
    """List the parameters of a pipeline or variant, or of the importer of a dataset, with their defaults."""
    if (kind := _require_group(group)) not in _WITH_PARAMETERS:
        raise ConfigError(f"only {' and '.join(_WITH_PARAMETERS)} have parameters, not {group}")
    variant = variant_of(name) if kind == "pipelines" else None
    if variant is not None:
        # What it is, and all parameters; the default stands beside those that it sets.
        params, sensors = default_params(pipeline_class(name)), ", ".join(variant.sensors)
        say(*filter(None, (variant.title, f"base: {variant.base}", sensors and f"sensors: {sensors}")))
        defaults, sets = describe(params), {path for path, _ in variant.settings}
        values = [
            (path, _format_value(v), _format_value(defaults.get(path)) if path in sets else "")
            for path, v in pipeline_parameters(name, []).items()
        ]
        if values:
            _show_table(("parameter", "value", "instead of"), values, params)
        return
    params = default_params(load(kind, name))
    if params is None:
        say(f"{name} takes no parameters")
        return
    rows = [(path, _format_value(value)) for path, value in describe(params).items()]
    _show_table(("parameter", "default"), rows, params)


def _show_table(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], params: Any) -> None:
    table, docs = _table(*columns, "meaning"), parameter_docs(params)
    for row in rows:
        table.add_row(*row, docs.get(row[0], ""))
    if has_sensor_settings(params):
        table.add_row("SENSOR.NAME", *("" for _ in columns[1:]), docs.get(BY_SENSOR, ""))
    console().print(table)


def _format_value(value: object) -> str:
    if isinstance(value, list):
        return ",".join(map(_format_value, value))
    return "none" if value is None else str(value)


def _require_group(name: str) -> Group:
    for group in _GROUPS:
        if group == name:
            return group
    raise ConfigError(f"unknown group '{name}'{did_you_mean(name, _GROUPS)}")


def show_decoders() -> None:
    """List the decoders that packages provide, then every type that fbench reads without one."""
    from fbench.replay.logs.codecs.foxglove.codec import foxglove_types
    from fbench.replay.logs.codecs.ros.codec import ros_types

    show_group("decoders")
    table = make_table("built in", "encodings", "kind")
    for name, kinds in foxglove_types().items():
        table.add_row(name, "protobuf, json", ", ".join(kinds))
    for name, kinds in ros_types().items():
        table.add_row(name, "cdr, ros1", ", ".join(kinds))
    out = console()
    out.print()
    out.print(table)


def show_decoder(name: str) -> None:
    """Print what a decoder, an installed one or `FILE.py:FUNCTION`, is for. Raises ConfigError for an unknown name."""
    decoder = load_decoder(name)
    table = _table("", "")
    table.show_header = False
    rows = {
        "kind": decoder.kind, "types": ", ".join(decoder.types) or "any", "topics": ", ".join(decoder.topics) or "any",
        "definition": "its own, where a log has none" if decoder.definition else "that of the log",
    }  # fmt: skip
    for what, text in rows.items():
        table.add_row(what, text)
    say(*filter(None, [name, *(inspect.getdoc(decoder.function) or "").splitlines()]))
    console().print(table)


def show_conditions() -> None:
    """List the conditions: on which sensors, and at which levels."""
    table = _table("condition", "sensors", "severity 1 to 5")
    for name in entry_points_of("conditions"):
        condition = load_condition(name)
        levels = "; ".join(f"{key} {_format_levels(values)}" for key, values in condition.levels.items())
        table.add_row(name, ", ".join(condition.kinds), levels)
    console().print(table)


def show_condition(text: str) -> None:
    """Print the formula of a condition, on which sensors it acts, what it needs, and its levels. Raises ConfigError for
    an unknown name.
    """
    name, scope = split_name(text)
    condition = load_condition(name)
    kinds = [kind for kind in condition.kinds if scope in ("", kind) or scope not in KINDS]
    say(text, *(inspect.getdoc(type(condition)) or "").splitlines())
    if isinstance(condition, MakesWeather):
        for kind in kinds:
            say("", f"{kind}:", *(inspect.getdoc(WEATHER_OF[kind]) or "").splitlines())
    needs = ", ".join(needs_of(condition))
    say("", f"sensors: {', '.join(kinds)}{f', of these {scope}' if scope and scope not in KINDS else ''}")
    say(f"needs: {needs or 'nothing'}")
    table = make_table("severity", *"12345", right=list("12345"))
    for key, values in condition.levels.items():
        table.add_row(key, *(f"{value:g}" for value in values))
    console().print(table)


def _format_levels(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def show_metrics() -> None:
    """List the plug-ins that score runs, then every metric."""
    from fbench.metrics.definitions.catalog import DEFINITIONS

    show_group("metrics")
    table = _table("metric", "better", "unit", "meaning")
    for definition in sorted(DEFINITIONS.values(), key=lambda definition: definition.name):
        table.add_row(definition.name, definition.better, definition.unit, definition.meaning)
    out = console()
    out.print()
    out.print(table)


def show_metric(name: str) -> None:
    """Print what one metric is, or what a plug-in that scores runs says of itself. Raises ConfigError for an unknown
    name.
    """
    from fbench.metrics.definitions.catalog import DEFINITIONS, definition_of

    points = entry_points_of("metrics")
    if name in points and name not in DEFINITIONS:
        say(f"{name}: {points[name].value}", "", inspect.getdoc(load("metrics", name)) or "")
        return
    definition = definition_of(name)
    table = _table("", "")
    table.show_header = False
    rows = {
        "metric": definition.name,
        "meaning": definition.meaning,
        "formula": definition.formula,
        "range": definition.range,
        "unit": "count" if definition.is_count else definition.unit,
        "better": definition.better,
        "null when": definition.undefined or "never",
        **{f"in {profile}": text for profile, text in definition.by_profile.items()},
        "source": str(definition.source),
    }
    for what, text in rows.items():
        table.add_row(what, text)
    console().print(table)


def show_profiles() -> None:
    """List every profile."""
    from fbench.metrics.profiles.catalog import profile_names, profile_of

    table = _table("profile", "what it counts")
    for name in profile_names():
        table.add_row(name, profile_of(name).summary)
    console().print(table)


def show_profile(name: str) -> None:
    """Print the rules of one profile. Raises ConfigError for an unknown name."""
    from fbench.metrics.profiles.catalog import describe_rules, profile_of

    profile = profile_of(name)
    out = console()
    out.print(f"{profile.name}: {profile.summary}")
    out.print()
    out.print(inspect.getdoc(type(profile)) or "")  # how it counts
    out.print()
    table = _table("rule", "value")
    for path, text in describe_rules(profile).items():
        table.add_row(path, text)
    out.print(table)


def _table(*columns: str) -> Table:
    table = make_table(*columns)
    for column in table.columns[:-1]:
        column.no_wrap = True
    return table
