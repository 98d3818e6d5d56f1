"""`fbench init` at work, and what it prints."""

from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid

from fbench.cli.show import console, print_json
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.data.files import replace_text
from fbench.replay.setup.configuration import config_place
from fbench.replay.setup.init import Placed, Written, draft_of, plain, toml_value, write_toml
from fbench.replay.setup.inspection import Draft

_MAX_VALUE = 48


def run_init(log: Path, out: Path | None, overwrite: bool, as_json: bool) -> None:
    """Write the configuration of a log and say what was guessed. Raises ConfigError where there is one already, or no
    folder for it. Raises LogError where the log can't be read, or holds no sensor.
    """
    place = config_place(log) if out is None else out
    _require_free(place, overwrite)
    faults = FaultLog()
    with explain_losses(faults):
        draft = draft_of(log, place, faults)
    written = write_toml(draft)
    replace_text(place, written.text)
    if as_json:
        print_json(_content(place, draft, written))
    else:
        _print(console(), place, draft, written)


def _require_free(place: Path, overwrite: bool) -> None:
    if place.is_dir():
        raise ConfigError(f"{place}: is a folder; name a file with -o")
    if place.exists() and not overwrite:
        raise ConfigError(f"{place}: exists; replace it with --overwrite, or name another file with -o")
    if not place.parent.is_dir():
        raise ConfigError(f"{place}: there is no folder '{place.parent}'")


def _content(place: Path, draft: Draft, written: Written) -> dict[str, object]:
    return {
        "config": str(place),
        "lines": [_line(p) for p in written.places],
        "left_out": [{"topic": item.topic, "why": item.why} for item in draft.left_out],
    }


def _line(p: Placed) -> dict[str, object]:
    return {
        "line": p.number,
        "table": list(p.table.path),
        "key": p.line.key,
        "value": p.line.value,
        "why": p.line.why,
        "guess": p.line.is_guess,
        "active": p.line.is_active and p.table.is_active,
    }


def _print(out: Console, place: Path, draft: Draft, written: Written) -> None:
    grid = Grid(box=None, pad_edge=False)
    grid.add_column("line", justify="right")
    for column in ("key", "value", "why"):
        grid.add_column(column, overflow="fold", no_wrap=column != "why")
    for p in written.places:
        if _is_shown(p):
            grid.add_row(str(p.number), *_cells(p))
    out.print(grid)
    for table in draft.tables:
        if not table.is_active:
            out.print(f"{plain('.'.join(table.path))}: {plain(table.notes[0])}", markup=False, soft_wrap=True)
    if draft.left_out:
        out.print(f"{len(draft.left_out)} topics aren't used; the file says why", markup=False)
    out.print(f"wrote {place}", markup=False, soft_wrap=True)
    numbers = ", ".join(str(p.number) for p in written.guesses)
    out.print(f"look at the guesses in lines {numbers}" if numbers else "no guesses", markup=False, soft_wrap=True)


def _is_shown(p: Placed) -> bool:
    """Classes are many, and the kind stands before the topic where it isn't a guess."""
    is_plain_kind = p.line.key == "kind" and not p.line.is_guess
    return p.line.is_active and p.table.is_active and p.table.path != ("classes",) and not is_plain_kind


def _cells(p: Placed) -> tuple[str, str, str]:
    value = p.line.value if isinstance(p.line.value, str) else toml_value(p.line.value)
    short = value if len(value) <= _MAX_VALUE else value[: _MAX_VALUE - 1] + "…"
    path = p.table.path[1:] if p.table.path[0] == "sensors" else p.table.path
    return ".".join((*path, p.line.key)), short, f"guess: {p.line.why}" if p.line.is_guess else p.line.why
