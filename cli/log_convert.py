"""`fbench log convert`."""

import sys
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from fbench.cli import options
from fbench.cli.progress import message_progress
from fbench.cli.show import console, fault_lines, make_table, print_json, say
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.data.scores import format_count

_NO_USE = ("LOG012", "LOG013")  # Topics that fbench has no use for are converted like all others


def convert(
    source: options.Log,
    out: Annotated[Path, Option("--out", "-o", help="NAME.mcap, NAME.parquet, or a folder of parts.")],
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing log.")] = False,
    compression: Annotated[
        str, Option(metavar="NAME", help="MCAP: zstd, lz4 or none. Parquet: zstd, snappy or none.")
    ] = "zstd",
    chunk_size: Annotated[int | None, Option(metavar="BYTES", help="MCAP chunk size (default: 1 MiB).")] = None,
    rows_per_group: Annotated[
        int | None, Option(metavar="N", help="Rows of a Parquet row group (default: as many as fit into 8 MiB).")
    ] = None,
    from_: Annotated[
        str | None,
        Option(
            "--from", metavar="T", help="Start of the cut: seconds after the first measurement, or a log time 'Nns'."
        ),
    ] = None,
    to: Annotated[str | None, Option(metavar="T", help="End of the cut (excluded).")] = None,
    topics: Annotated[
        list[str] | None,
        Option(metavar="PATTERN", help="Keep only these topics or sensors ('!PATTERN' excludes); repeatable."),
    ] = None,
    split_s: Annotated[
        float | None, Option(metavar="SECONDS", help="Write a folder of MCAP files, each of this duration.")
    ] = None,
    split_mb: Annotated[
        float | None, Option(metavar="MB", help="Write a folder of MCAP files, each of about this size.")
    ] = None,
    decode: Annotated[
        bool, Option("--decode", help="Convert another program's log to fbench's messages; leave out the rest.")
    ] = False,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    json: options.Json = False,
) -> None:
    """Write a log in another form, without loss; cut it by time, keep some topics, split it, or disturb it."""
    from fbench.replay.conditions.disturb import Disturbance
    from fbench.replay.conditions.effects import describe
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.engine.excerpt import make_excerpt
    from fbench.replay.logs.convert.run import ConvertRequest
    from fbench.replay.logs.convert.run import convert as convert_container
    from fbench.replay.logs.convert.target import Target, make_split
    from fbench.replay.logs.open import open_container
    from fbench.replay.logs.setup import Setup
    from fbench.replay.setup.request import make_disturbance
    from fbench.replay.setup.source import NO_CONFIG, LogRequest, log_source

    target = Target(out, overwrite, compression, chunk_size, rows_per_group, make_split(split_s, split_mb))
    if condition and (from_ or to):
        raise ConfigError("--condition disturbs a whole log: convert it first, and cut what comes of it")
    decode = decode or bool(condition)  # what is disturbed becomes fbench's own messages
    if not decode and (rig or decoder or config not in (None, NO_CONFIG)):
        raise ConfigError(
            "--config, --rig and --decoder change what is decoded: give --decode too, or leave them to `fbench replay`"
        )
    about = LogRequest(source, config, rig or [], decoder=decoder or ())
    log = log_source(about) if decode else None
    setup = Setup() if log is None else log.setup
    disturbance = Disturbance() if log is None else make_disturbance(log, condition, seed)
    request = ConvertRequest(tuple(topics or ()), make_excerpt(from_, to, None), decode, setup, disturbance)
    faults = FaultLog()
    with redirect_stdout(sys.stderr), explain_losses(faults):  # what a decoder prints is no line of --json
        container = open_container(source, faults)
        total = sum(container.counts.values())
        with message_progress(f"{source.name} → {target.path.name}", total) as progress:
            result = convert_container(container, target, request, progress)
    rows = [row for row in faults.rows() if row["code"] not in _NO_USE]
    code = EXIT_LOSSY if faults.num_lost else EXIT_OK
    if json:
        print_json({**asdict(result), "path": str(result.path), "faults": rows})
        raise typer.Exit(code)
    table = make_table("topic", "messages", right=["messages"])
    table.columns[0].overflow = "fold"
    for topic, num in result.messages.items():
        table.add_row(topic, str(num))
    console().print(table)
    for topic, num in result.left_out.items():
        say(f"left out: {format_count(num, 'message')} on {topic}, which fbench doesn't understand")
    say(*(f"changed: {sensor}: {describe(row)}" for sensor, row in result.effects.items()))
    rigs = f", {format_count(result.num_rigs, 'rig')}" if result.num_rigs else ""
    parts = f" in {format_count(len(result.parts), 'part')}" if result.parts else ""
    say(*fault_lines(rows), f"id: {result.log_id}")
    messages = format_count(result.num_messages, "message")
    say(f"log: {result.path}: {messages}{rigs}, {result.num_bytes / 1e6:.3g} MB{parts}")
    raise typer.Exit(code)
