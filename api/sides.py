"""Sides of a comparison: the cells of runs and suites, and which belong together."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from fbench.api.scores import open_folder
from fbench.api.suites.cells import CELLS
from fbench.metrics.comparison.cells import CLEAR, OTHER, CellName, CellPair, CellSide
from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import read_table

_COLUMNS = ("log", "pipeline", "condition", "rate", "seed", "state", "reason", "run")

Entry: TypeAlias = CellSide | str
"""A cell, or why there is none."""


@dataclass(frozen=True)
class Side:
    """All cells of one side."""

    path: Path
    cells: Mapping[CellName, Entry]
    is_suite: bool


def open_results(path: Path) -> Side:
    """Open a run or a suite. Raises ConfigError where there is nothing. Raises RunError where it can't be read."""
    if not (path / CELLS).is_file():
        run = open_folder(path)
        return Side(path, {_name(run): CellSide.of(run)}, False)
    table = read_table(path / CELLS)
    if missing := [name for name in _COLUMNS if name not in table.column_names]:
        raise RunError(f"{path / CELLS}: not a table of cells (no {missing[0]})")
    cells: dict[CellName, Entry] = {}
    for row in table.select(list(_COLUMNS)).to_pylist():
        log, pipeline, condition, rate = (str(row[key] or "") for key in ("log", "pipeline", "condition", "rate"))
        name = CellName(log, pipeline, condition, rate, int(row["seed"] or 0))
        if name in cells:
            raise RunError(f"{path / CELLS}: {name} is there twice")
        if not row["run"]:
            cells[name] = f"{row['state']}: {row['reason'] or 'no reason is given'}"
            continue
        folder = path / str(row["run"])
        if not folder.resolve().is_relative_to(path.resolve()):
            raise RunError(f"{path / CELLS}: {row['run']} isn't inside the suite")
        cells[name] = CellSide.of(open_folder(folder))
    return Side(path, cells, True)


def _name(run: Run) -> CellName:
    manifest = run.manifest
    condition = "+".join(map(str, manifest.conditions)) or CLEAR
    return CellName(manifest.log.name, manifest.pipeline, condition, "", manifest.seed or 0)


def pair_cells(base: Side, head: Side) -> tuple[list[CellPair], list[str], list[str]]:
    """Return the cells that both sides have, what the head lacks, and notes on what only the head has. Raises
    ConfigError where a run is to be compared with a suite.
    """
    if base.is_suite != head.is_suite and not (len(base.cells) == len(head.cells) == 1):
        what = ("a suite" if side.is_suite else "a run" for side in (base, head))
        raise ConfigError(f"{base.path} is {next(what)}, {head.path} is {next(what)}: compare like with like")
    if len(base.cells) == len(head.cells) == 1 and not (base.is_suite and head.is_suite):
        ((before, one),), ((name, two),) = base.cells.items(), head.cells.items()
        if isinstance(one, CellSide) and isinstance(two, CellSide):
            is_same = before.pipeline == name.pipeline
            named = name if is_same else replace(name, pipeline=f"{before.pipeline}{OTHER}{name.pipeline}")
            return [CellPair(named, one, two)], [], []
    pairs, failures, notes = [], [], []
    for name, one in base.cells.items():
        other: Entry | None = head.cells.get(name)
        if isinstance(one, str):
            state = one if isinstance(other, str) else "there now" if other else "gone"
            notes.append(f"{name}: base has no run ({one}); head: {state}")
        elif isinstance(other, CellSide):
            pairs.append(CellPair(name, one, other))
        else:
            failures.append(f"{name}: base has a run, head has none ({other or 'no such cell'})")
    notes += [f"{name}: only head has it" for name in head.cells if name not in base.cells]
    return pairs, failures, notes
