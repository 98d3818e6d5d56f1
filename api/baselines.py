"""Baselines for git: counts and digests of accepted runs, with who accepted them, when and why."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fbench.api.sides import Entry, open_results
from fbench.metrics.comparison.cells import CellName, CellSide, Stretches
from fbench.replay.contracts.errors import ConfigError, RunError, first_wrong
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import Score, score_rows
from fbench.replay.runs.manifest import Manifest
from fbench.replay.runs.secrets import without_secrets

_MAX_BYTES = 64 << 20
_TIMEOUT_S = 10.0


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Acceptance(_Strict):
    """Who took the results for good."""

    by: str
    at: str  # Date, as given or of the commit: never the clock, so that equal inputs give equal bytes
    reason: Annotated[str, Field(min_length=1)]


class _Place(_Strict):
    place: tuple[str, str, str, str]
    counts: list[list[int]]


class _Cell(_Strict):
    name: dict[str, str | int]
    manifest: Manifest
    scores: list[dict[str, Any]]
    unit: str
    digests: list[str]
    counts: list[_Place]


class _File(_Strict):
    format: Literal[1]
    kind: Literal["fbench baseline"]
    accepted: Acceptance
    cells: Annotated[list[_Cell], Field(min_length=1)]


@dataclass(frozen=True)
class Accepted:
    """A baseline that was written."""

    path: Path
    acceptance: Acceptance
    num_cells: int
    replaced: Acceptance | None  # Of the baseline before


def accept(source: Path, reason: str, out: Path, by: str | None = None, at: str | None = None) -> Accepted:
    """Write a baseline of a run or a suite.

    Args:
        source: Folder of the run or suite.
        reason: Why its results are good.
        out: The file.
        by: Who accepts them; `None`: the user that git knows.
        at: When; `None`: the date of the last commit of the repository that `out` is in.

    Raises:
        ConfigError: where nobody or no date is known, or the file can't be written.
        RunError: where a run can't be read.
    """
    if not reason.strip():
        raise ConfigError("--reason: say why these results are good; reviewers read it in git")
    folder = out.parent if out.parent != Path() else Path.cwd()
    by = by or _ask_git(folder, "config", "user.name")
    at = at or _ask_git(folder, "log", "-1", "--format=%cs")
    if not by or not at:
        raise ConfigError(
            f"{'who accepts it' if not by else 'when'}? git doesn't know; give --{'by' if not by else 'at'}"
        )
    acceptance = Acceptance(by=without_secrets(by), at=at, reason=without_secrets(reason.strip()))
    cells = [_keep(name, cell) for name, cell in open_results(source).cells.items() if isinstance(cell, CellSide)]
    if not cells:
        raise ConfigError(f"{source}: no cell has a run, so there is nothing to accept")
    before = _read(out).accepted if out.is_file() else None
    file = _File(format=1, kind="fbench baseline", accepted=acceptance, cells=cells)
    out.parent.mkdir(parents=True, exist_ok=True)
    replace_text(out, _lines(file))
    return Accepted(out, acceptance, len(cells), before)


def _ask_git(folder: Path, *words: str) -> str:
    if (git := shutil.which("git")) is None:
        return ""
    try:
        done = subprocess.run(  # noqa: S603  # no shell, and words of ours
            [git, "-C", str(folder), *words], capture_output=True, text=True, encoding="utf-8", errors="replace",
            timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _keep(name: CellName, cell: CellSide) -> _Cell:
    own = cell.stretches
    counts = [_Place(place=place, counts=rows.tolist()) for place, rows in own.counts.items()]
    # What is only read by people and by reports stays out: the file is for git.
    manifest = cell.manifest.model_copy(update={"effects": {}, "versions": cell.manifest.versions})
    rows = [{k: v for k, v in row.items() if k != "counts"} for row in score_rows(cell.scores)]
    return _Cell(
        name=asdict(name), manifest=manifest, scores=rows, unit=own.unit, digests=list(own.digests), counts=counts
    )


def _lines(file: _File) -> str:
    """One line a number or stretch of counts, so that a change is a small diff."""
    data = file.model_dump(mode="json")
    cells = data.pop("cells")
    head = json.dumps(data, indent=1)[:-2]
    texts = []
    for cell in cells:
        parts = [f'"{key}": {json.dumps(cell[key])}' for key in ("name", "manifest", "unit", "digests")]
        for key in ("scores", "counts"):
            rows = ",\n  ".join(json.dumps(row) for row in cell[key])
            parts.append(f'"{key}": [\n  {rows}\n ]')
        texts.append("{" + ",\n ".join(parts) + "}")
    return f'{head},\n "cells": [\n' + ",\n".join(texts) + "\n]}\n"


def _read(path: Path) -> _File:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RunError(f"{path}: more than {_MAX_BYTES >> 20} MiB, which no baseline needs")
        return _File.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise RunError(f"{path}: not a baseline of this version of fbench ({first_wrong(error)})") from error
    except OSError as error:
        raise RunError(f"{path}: can't be read ({error.strerror})") from error


def load_baseline(path: Path) -> Mapping[CellName, Entry]:
    """Return the cells of a baseline. Raises RunError where it isn't one."""
    found: dict[CellName, Entry] = {}
    for cell in _read(path).cells:
        try:
            name = CellName(**cell.name)  # type: ignore[arg-type]
            scores = [Score(**{("class_" if k == "class" else k): v for k, v in row.items()}) for row in cell.scores]
            counts = {entry.place: np.array(entry.counts, np.int64) for entry in cell.counts}
        except (TypeError, ValueError, OverflowError) as error:
            raise RunError(f"{path}: not a baseline ({error})") from error
        if name in found or any(rows.ndim != 2 or len(rows) != len(cell.digests) for rows in counts.values()):
            raise RunError(f"{path}: not a baseline ({name}: twice, or counts don't fit)")
        found[name] = CellSide(cell.manifest, scores, None, Stretches(cell.unit, counts, tuple(cell.digests)))
    return found
