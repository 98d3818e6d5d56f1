"""Plug-ins by name: built-ins and outsiders come in by the same entry points, or from a single file."""

import importlib.util
import inspect
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, did_you_mean, one_line

Group = Literal["conditions", "datasets", "decoders", "pipelines", "metrics", "profiles", "reports"]


def entry_points_of(group: Group) -> dict[str, EntryPoint]:
    """Return the entry points of `fbench.GROUP` by name, sorted, without importing them. Raises ConfigError where two
    packages claim one name.
    """
    points: dict[str, EntryPoint] = {}
    for point in sorted(find_installed(group), key=lambda p: (p.name, p.value)):
        if point.name in points and points[point.name].value != point.value:
            raise ConfigError(f"two {group} are called '{point.name}': {points[point.name].value} and {point.value}")
        points[point.name] = point
    return points


def load(group: Group, name: str, kind: type | None = None, others: Iterable[str] = ()) -> Any:
    """Return what a name of `fbench.GROUP` stands for: a class, profile or decoder, or what `FILE.py:NAME` names.
    Raises ConfigError for an unknown name (with the nearest one) or a plug-in that can't be imported.

    Args:
        group: Of plug-ins.
        name: Of an entry point, or `FILE.py:NAME`.
        kind: What a file defines that can be meant: objects of this kind; `None`: classes.
        others: Names besides those of entry points that may have been meant.
    """
    if ".py:" in name:
        return _from_file(name, kind)
    points = entry_points_of(group)
    if name not in points:
        raise ConfigError(f"unknown {group.removesuffix('s')} '{name}'{did_you_mean(name, [*points, *others])}")
    try:
        return points[name].load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"{group.removesuffix('s')} '{name}' ({points[name].value}) can't be loaded: {error}"
        ) from error


def version_of(group: Group, name: str) -> str:
    """Return the package and version behind an entry point as ` (PACKAGE VERSION)`, else nothing."""
    point = entry_points_of(group).get(name)
    return "" if point is None or point.dist is None else f" ({point.dist.name} {point.dist.version})"


def absolute_name(name: str) -> str:
    """Return `FILE.py:NAME` as seen from any folder; other names stay."""
    path, _, member = name.rpartition(".py:")
    return f"{Path(f'{path}.py').resolve()}:{member}" if path else name


def _from_file(name: str, kind: type | None) -> Any:
    path, _, member = name.rpartition(":")
    file = Path(path).resolve()
    if not file.is_file():
        raise ConfigError(f"{path}: no such file")
    module_name = f"fbench_plugin_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except INTERRUPTS:
        raise
    except BaseException as error:
        raise ConfigError(f"{path}: can't be imported: {one_line(error)}") from error
    found: dict[str, Any]
    if kind is None:
        what, hint = "class", ""
        found = {n: v for n, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module_name}
    else:
        what, hint = "function", " below @decodes(TYPE, kind=KIND)"
        found = {n: v for n, v in vars(module).items() if isinstance(v, kind)}
    if member not in found:
        raise ConfigError(f"{path}: has no {what} '{member}'{hint}{did_you_mean(member, found)}")
    return found[member]


def find_installed(group: str) -> Sequence[EntryPoint]:
    """Return the entry points of `fbench.GROUP`: those of the first call with `sys.path` as it is now."""
    return _find_all(tuple(sys.path)).get(f"fbench.{group}", ())


@lru_cache(4)
def _find_all(path: tuple[str, ...]) -> Mapping[str, Sequence[EntryPoint]]:
    """What is installed, by group: to find out takes some 10 ms, and a command asks a dozen times."""
    points = entry_points()
    return {group: tuple(points.select(group=group)) for group in points.groups}
