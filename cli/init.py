"""`fbench init`."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from fbench.cli import options
from fbench.cli.show import console, make_table, print_json, printable, say
from fbench.replay.contracts.errors import EXIT_NO
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.replay.setup.init import Written
    from fbench.replay.setup.inspection import Draft
    from fbench.replay.setup.proof import Proof

_MAX_VALUE = 48
_PIPELINES = ("camera2d", "lidar2d", "radar2d", "early2d", "late2d", "lidar3d", "radar3d", "stereo3d", "early3d",
              "late3d")  # fmt: skip


def init(
    log: options.Log,
    out: Annotated[
        Path | None, Option("--out", "-o", help="File to write (default: fbench.toml beside the log).")
    ] = None,
    decoder: options.Decoders = None,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing file.")] = False,
    json: options.Json = False,
) -> None:
    """Inspect a log and write an fbench.toml that describes it, with the reasons."""
    from fbench.replay.contracts.errors import ConfigError
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.data.files import make_parent, replace_text
    from fbench.replay.setup.configuration import config_place
    from fbench.replay.setup.init import draft_of, write_toml
    from fbench.replay.setup.proof import find_ready, prove

    place = config_place(log) if out is None else out
    if place.is_dir():
        raise ConfigError(f"{place}: is a folder; name a file with -o")
    if place.exists() and not overwrite:
        raise ConfigError(f"{place}: exists; replace it with --overwrite, or name another file with -o")
    make_parent(place)
    faults = FaultLog()
    with redirect_stdout(sys.stderr):  # what a decoder prints is no line of --json
        with explain_losses(faults):
            draft = draft_of(log, place, faults, decoder or ())
        proof = prove(draft, log, place, decoder or ())
        ready = {} if proof.failure else find_ready(proof.source, _PIPELINES)
    draft = replace(proof.draft, notes=tuple(_proof_lines(proof, ready)))
    written = write_toml(draft)
    replace_text(place, written.text)
    if json:
        lines = [
            {
                "line": p.number,
                "table": list(p.table.path),
                "key": p.line.key,
                "value": p.line.value,
                "why": p.line.why,
                "guess": p.line.is_guess,
                "active": p.line.is_active and p.table.is_active,
            }
            for p in written.places
        ]
        left_out = [{"topic": item.topic, "why": item.why} for item in draft.left_out]
        tried = {"frames": proof.frames, "remarks": list(proof.remarks), "failure": proof.failure, "pipelines": ready}
        print_json({"config": str(place), "lines": lines, "left_out": left_out, "proof": tried})
    else:
        _print(place, draft, written)
    if proof.failure:
        sys.stderr.write(f"fbench: {printable(f'the log cannot be replayed with {place} yet: {proof.failure}')}\n")
        raise typer.Exit(EXIT_NO)


def _proof_lines(proof: "Proof", ready: Mapping[str, str]) -> Iterator[str]:
    """Say what became of the trial."""
    if proof.failure:
        yield f"Tried: the log can't be replayed with this file yet: {proof.failure}"
    else:
        yield f"Tried: {proof.frames}."
    yield from (f"  {remark}" for remark in proof.remarks)
    good = [name for name, why in ready.items() if not why]
    if ready:
        yield f"Pipelines that can start: {', '.join(good) or 'none'}"
    yield from (f"  {name}: {why}" for name, why in ready.items() if why)


def _print(place: Path, draft: "Draft", written: "Written") -> None:
    from fbench.replay.setup.init import plain, toml_value

    table = make_table("line", right=["line"])
    for column in ("key", "value", "why"):
        table.add_column(column, overflow="fold", no_wrap=column != "why")
    for p in written.places:
        path, line = p.table.path, p.line
        # Classes are many, and the kind stands before the topic where it isn't a guess.
        is_plain = path == ("classes",) or (line.key == "kind" and not line.is_guess)
        if line.is_active and p.table.is_active and not is_plain:
            value = line.value if isinstance(line.value, str) else toml_value(line.value)
            short = value if len(value) <= _MAX_VALUE else value[: _MAX_VALUE - 1] + "…"
            key = ".".join((*(path[1:] if path[:1] == ("sensors",) else path), line.key))
            table.add_row(str(p.number), key, short, f"guess: {line.why}" if line.is_guess else line.why)
    console().print(table)
    say(*(f"{plain('.'.join(t.path))}: {plain(t.notes[0])}" for t in draft.tables if not t.is_active))
    if draft.left_out:
        num = len(draft.left_out)
        say(f"{format_count(num, 'topic')} {'is' if num == 1 else 'are'}n't used; the file says why")
    numbers = ", ".join(str(p.number) for p in written.guesses)
    say(*map(plain, draft.notes))
    lines = "guess in line" if len(written.guesses) == 1 else "guesses in lines"
    say(f"wrote {place}", f"look at the {lines} {numbers}" if numbers else "no guesses")
