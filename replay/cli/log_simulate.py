"""`fbench log simulate`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fbench.replay.cli.options import Json


def simulate(
    world: Annotated[
        str,
        typer.Argument(
            metavar="WORLD",
            help="urban, highway; suite: all logs of the fixed suite; training: those of the built-in detector.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="FILE.mcap or FOLDER.parquet; of a suite the folder for its logs.")
    ],
    condition: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="clear, traffic, rain, heavy-rain, fog, night ..., or a mixture: rain+night."
        ),
    ] = "clear",
    seconds: Annotated[float, typer.Option(metavar="S", help="Length of the log, in s.")] = 10.0,
    seed: Annotated[
        int, typer.Option(metavar="N", help="Another seed, another world; the same one, the same bytes.")
    ] = 0,
    split: Annotated[
        Literal["dev", "test"] | None,
        typer.Option(help="Of a suite: seeds to develop on (dev, unless said otherwise), or those to report."),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help="TOML with the sensors; else the thesis's rig.")
    ] = None,
    sensors: Annotated[
        list[str] | None,
        typer.Option("--sensors", metavar="PATTERN", help="Only these sensors (not: '!PATTERN'); repeatable."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Change a sensor or the weather; repeatable."),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=256, help="Messages made at once; changes no byte.")
    ] = None,
    form: Annotated[
        Literal["mcap", "parquet"] | None, typer.Option(help="Of a suite's logs; mcap, unless said otherwise.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing logs.")] = False,
    json: Json = False,
) -> None:
    """Simulate a drive through a city or along a highway, with every sensor and perfect truth."""
    from fbench.datasets.city.wish import CityWish
    from fbench.replay.cli.simulate_job import SimulateJob, run_simulation

    wish = CityWish(world, condition, seconds, seed, rig, tuple(sensors or ()), tuple(settings or ()))
    run_simulation(SimulateJob(wish, out, split, threads, form, overwrite, json))
