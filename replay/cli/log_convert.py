"""`fbench log convert`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.log_options import Config, RigFiles
from fbench.replay.cli.options import Json, Log


def convert(
    source: Log,
    out: Annotated[Path, typer.Option("--out", "-o", help="NAME.mcap, NAME.parquet, or a folder of parts.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing log.")] = False,
    compression: Annotated[
        str, typer.Option(metavar="NAME", help="MCAP: zstd, lz4 or none. Parquet: zstd, snappy or none.")
    ] = "zstd",
    chunk_size: Annotated[int | None, typer.Option(metavar="BYTES", help="Of MCAP; else 1 MiB.")] = None,
    rows_per_group: Annotated[
        int | None, typer.Option(metavar="N", help="Of Parquet; else as many as make 8 MiB.")
    ] = None,
    from_: Annotated[
        str | None,
        typer.Option("--from", metavar="T", help="Cut: seconds after the first measurement, or a log time 'Nns'."),
    ] = None,
    to: Annotated[str | None, typer.Option("--to", metavar="T", help="Where to stop, itself left out.")] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option("--topics", metavar="PATTERN", help="Keep these topics or sensors (not: '!PATTERN'); repeatable."),
    ] = None,
    split_s: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Write a folder of MCAP files, each of this duration.")
    ] = None,
    split_mb: Annotated[
        float | None, typer.Option(metavar="MB", help="Write a folder of MCAP files, each of about this size.")
    ] = None,
    decode: Annotated[
        bool, typer.Option("--decode", help="Turn the log of others into fbench's own messages; the rest is left out.")
    ] = False,
    config: Config = None,
    rig: RigFiles = None,
    json: Json = False,
) -> None:
    """Write a log in another form, without loss; cut it by time, keep some topics, or split it."""
    from fbench.replay.cli.convert_job import run_convert
    from fbench.replay.config.source import NO_CONFIG, LogWish, log_source
    from fbench.replay.errors import ConfigError
    from fbench.replay.excerpt import make_excerpt
    from fbench.replay.logs.convert.parts import make_split
    from fbench.replay.logs.convert.run import Wish
    from fbench.replay.logs.convert.target import Target
    from fbench.replay.logs.setup import Setup

    target = Target(out, overwrite, compression, chunk_size, rows_per_group, make_split(split_s, split_mb))
    if not decode and (rig or config not in (None, NO_CONFIG)):
        raise ConfigError(
            "--config and --rig change what is decoded: give --decode too, or leave them to `fbench replay`"
        )
    setup = log_source(LogWish(source, config, rig or [])).setup if decode else Setup()
    wish = Wish(tuple(topics or ()), make_excerpt(from_, to, None), decode, setup)
    raise typer.Exit(run_convert(source, target, wish, json))
